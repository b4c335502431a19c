"""Running Python code of the user's: what it imports, prints and raises, and how long it takes."""

import contextlib
import os
import re
import sys
import threading
import traceback
from collections.abc import Callable, Iterator, Sequence
from hashlib import sha256
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec, PathFinder, SourceFileLoader
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import CodeType, FrameType, ModuleType
from typing import Any

from cgm_jax.config.fields import SettingError

PATIENCE_SECONDS = 10.0
"""After this a line says where the user's code stands; then after twice as long, and so on."""

MAX_CODE_BYTES = 2**24

Admit = Callable[[Path, bytes], None]
"""Is asked for every file with its bytes, just before they run; raises if they may not."""

_digests: dict[str, str] = {}
_finders: dict[Path, "Neighbours"] = {}


def run_files(folder: Path) -> dict[str, str]:
    """SHA-256 of the user's files in a folder that have run in this process, by absolute path."""
    return {path: digest for path, digest in _digests.items() if Path(path).is_relative_to(folder)}


def load_file(path: Path, admit: Admit) -> ModuleType:
    """Run a file as a module, which may import its neighbours; once for the same bytes.

    Both `import helpers` and `from . import helpers` find helpers.py beside the file, whatever the
    working directory. A neighbour comes before an installed module, as for `python FILE.py`.

    Args:
        path: the file, absolute, without symbolic links.
        admit: see `Admit`.
    """
    finder = neighbours_of(path.parent, admit)
    # Under a name of its own: a user's file may be called like any module of Python's.
    name = f"_named_{sha256(os.fsencode(path)).hexdigest()[:16]}"
    if name in sys.modules:
        return sys.modules[name]
    loader = _Source(name, str(path), admit)
    spec = spec_from_file_location(
        name, path, loader=loader, submodule_search_locations=[str(path.parent)]
    )
    assert spec is not None
    finder.found.add(name)
    module = module_from_spec(spec)
    sys.modules[name] = module  # so that dataclasses in the file find their module
    try:
        loader.exec_module(module)
    except BaseException:
        del sys.modules[name]
        raise
    return module


def neighbours_of(folder: Path, admit: Admit, only: str | None = None) -> "Neighbours":
    """Let the modules in a folder be imported, ahead of others.

    Args:
        folder: absolute.
        admit: see `Admit`.
        only: the one package there that may be; None for all.
    """
    finder = _finders.setdefault(folder, Neighbours(folder))
    finder.admit, finder.only = admit, only
    for other in _finders.values():
        if other is not finder:
            other.make_way(folder, only)
    finder.forget_if_stale()
    sys.meta_path[:] = [finder, *(one for one in sys.meta_path if one is not finder)]
    return finder


class Neighbours(MetaPathFinder):
    """Finds the modules in one folder.

    Attributes:
        found: top-level names of those that have been.
        admit, only: see `neighbours_of`.
    """

    admit: Admit
    only: str | None

    def __init__(self, folder: Path) -> None:
        self._folder = str(folder)
        self.found: set[str] = set()

    def find_spec(
        self, fullname: str, path: Sequence[str] | None = None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """See `importlib.abc.MetaPathFinder`."""
        top = fullname.partition(".")[0]
        if path is None:
            if top in sys.stdlib_module_names or self.only not in (None, top):
                return None
            path = [self._folder]
        elif top not in self.found:
            return None
        spec = PathFinder.find_spec(fullname, path, target)
        if spec is None:
            return None
        if spec.origin is None:  # a folder without __init__.py, such as assets/ or data/
            if fullname == top and PathFinder.find_spec(fullname) is not None:
                return None
            spec.submodule_search_locations = list(spec.submodule_search_locations or ())
        elif type(spec.loader) is SourceFileLoader:
            spec.loader = _Source(fullname, spec.origin, self.admit)
        else:
            _admit(self.admit, Path(spec.origin), Path(spec.origin).read_bytes())
        self.found.add(top)
        return spec

    def make_way(self, folder: Path, only: str | None) -> None:
        """Forget modules that have the same names as some in another folder, whose turn it is."""
        names = self.found if only is None else self.found & {only}
        self.forget({top for top in names if PathFinder.find_spec(top, [str(folder)])})

    def forget_if_stale(self) -> None:
        """Forget all modules if a file of one has been edited since it ran."""
        ours = run_files(Path(self._folder))
        if any(digest_of(Path(path)) != digest for path, digest in ours.items()):
            self.forget(self.found)
            for path in ours:
                del _digests[path]

    def forget(self, tops: set[str]) -> None:
        """Let modules be found and run anew. What has imported them keeps them."""
        for name in list(sys.modules):
            if name.partition(".")[0] in tops:
                del sys.modules[name]
        self.found = self.found - tops


class _Source(SourceFileLoader):
    """Runs a file's source, and never a cached .pyc, which may hold other code than it says."""

    def __init__(self, name: str, path: str, admit: Admit) -> None:
        super().__init__(name, path)
        self._admit = admit

    def get_code(self, fullname: str) -> CodeType:
        path = self.get_filename(fullname)
        data = self.get_data(path)
        _admit(self._admit, Path(path), data)
        return self.source_to_code(data, path)


def _admit(admit: Admit, path: Path, data: bytes) -> None:
    admit(path, data)
    _digests[str(path)] = sha256(data).hexdigest()


def digest_of(path: Path) -> str | None:
    """SHA-256 of a file of code as it is now; None where there is none, or none to be read."""
    try:
        return sha256(path.read_bytes()).hexdigest() if is_code(path) else None
    except OSError:
        return None


def is_code(path: Path) -> bool:
    """Whether a path is that of an ordinary file, of a size that code may have."""
    try:
        return path.is_file() and path.stat().st_size <= MAX_CODE_BYTES
    except OSError:  # such as a name that is too long
        return False


@contextlib.contextmanager
def user_code(setting: str, what: str, patience: float = PATIENCE_SECONDS) -> Iterator[None]:
    """Run code of the user's in the block.

    What it prints goes to standard error, so that output proper stays what it is; it may change
    the working directory for itself only; and if it takes long a line says where it stands.

    Args:
        setting: the setting that names the code.
        what: the file or the function that runs.
        patience: seconds until the first line about it.

    Raises:
        SettingError: the block raised anything at all, `SystemExit` included; one line says what,
            and in which line of which file.
    """
    directory = _working_directory()
    try:
        with (
            contextlib.redirect_stdout(sys.stderr),
            _said_where_it_stands(f"{setting}: {what}", patience),
        ):
            yield
    except (SettingError, KeyboardInterrupt):
        raise
    except BaseException as error:
        raise SettingError(f"{setting}: {what} fails with {_described(error)}") from error
    finally:
        if directory is not None and _working_directory() != directory:
            os.chdir(directory)


def _working_directory() -> str | None:
    try:
        return os.getcwd()  # noqa: PTH109 -- as it is, a text
    except OSError:  # it has been removed
        return None


def _described(error: BaseException) -> str:
    """An exception in one line, with its place in the user's code."""
    # JAX hands on an error in a host callback as the text of a whole traceback.
    message, _, inner = str(error).partition("Traceback (most recent call last):")
    raised = [line for line in inner.splitlines() if line.strip() and not line.startswith(" ")]
    lines = raised or message.strip().splitlines() or [""]
    place = _place_of_error(error, inner)
    text = f"{type(error).__name__}: {lines[0].strip()}".removesuffix(": ")
    return f"{text} ({place})" if place else text


def _place_of_error(error: BaseException, inner: str) -> str | None:
    if isinstance(error, SyntaxError) and error.filename:
        return f"{error.filename}, line {error.lineno}"
    frames = [(one.filename, one.lineno) for one in traceback.extract_tb(error.__traceback__)]
    frames += re.findall(r'File "(.+)", line (\d+)', inner)
    places = [f"{file}, line {line}" for file, line in frames if file in _digests]
    return places[-1] if places else None


@contextlib.contextmanager
def _said_where_it_stands(what: str, patience: float) -> Iterator[None]:
    ended = threading.Event()
    arguments = (what, patience, threading.get_ident(), ended)
    threading.Thread(target=_say_where_it_stands, args=arguments, daemon=True).start()
    try:
        yield
    finally:
        ended.set()


def _say_where_it_stands(what: str, patience: float, thread: int, ended: threading.Event) -> None:
    waited = 0.0
    while not ended.wait(patience):
        waited += patience
        patience = waited
        place = _place_of_frame(sys._current_frames().get(thread))
        with contextlib.suppress(OSError, ValueError):  # nobody reads
            print(f"{what} has taken {waited:.0f} s so far; it is at {place}", file=sys.stderr)


def _place_of_frame(frame: FrameType | None) -> str:
    """The innermost line of the user's, or else of anybody's."""
    innermost: Any = frame
    while frame is not None and frame.f_code.co_filename not in _digests:
        frame = frame.f_back
    shown = frame or innermost
    return f"{shown.f_code.co_filename}, line {shown.f_lineno}" if shown else "its end"
