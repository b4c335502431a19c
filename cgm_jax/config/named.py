"""FILE.py:NAME or package.module:NAME, something in a file of the user's own; gymnasium:MODULE:ID.

What the user names, on a command line or in a program, runs, and so does what it imports. What only
a run directory's config.json names may come from anybody: of that only those files run, byte for
byte, that the user has named on this machine before (see allowed.py). That holds for the named file
and for all modules of its folder, or of its package, that it imports; installed packages are not
looked at, and what a file reads or runs by other means is its own responsibility.
"""

import contextlib
import importlib
import importlib.util
import operator
import os
import re
import shlex
from importlib.machinery import PathFinder
from pathlib import Path
from types import ModuleType
from typing import Any

from cgm_jax.config import allowed
from cgm_jax.config.fields import SettingError
from cgm_jax.config.user_code import (
    Admit,
    is_code,
    load_file,
    neighbours_of,
    run_files,
    user_code,
)

_named_now: set[Path] = set()
"""Files that the user has named on this process's command line."""

NAMED_NOW, FROM_CONFIG, BY_PROGRAM = "named now", "from config", "by program"

_texts_named_now: set[str] = set()
_texts_from_config: set[str] = set()
"""The same, as they were named."""

_hosted: dict[str, dict[str, dict[str, str]]] = {}
"""What `note_hosted` was told, by name."""

_from_config: set[Path] = set()
"""Files that only a config.json has named."""


GYMNASIUM = "gymnasium:"
"""Prefix of environments of Gymnasium's: gymnasium:ID, or gymnasium:MODULE:ID to import MODULE."""


def is_gymnasium(text: str) -> bool:
    """Whether a setting's value names an environment of Gymnasium's."""
    return text.startswith(GYMNASIUM)


def gymnasium_name(text: str) -> tuple[str | None, str]:
    """The module to import first, if any, and the environment's id.

    Raises:
        SettingError: it is of another form.
    """
    module, _, env_id = text.removeprefix(GYMNASIUM).rpartition(":")
    if not re.fullmatch(r"([\w.-]+/)?[\w.-]+", env_id):
        raise SettingError(f"env: {text!r} is neither gymnasium:ID nor gymnasium:MODULE:ID")
    return module or None, env_id


def import_gymnasium_module(text: str, trust: str) -> None:
    """Import the module of gymnasium:MODULE:ID, if it may run.

    Args:
        text: the name.
        trust: `trust_of` it in the process that asks for it.

    Raises:
        SettingError: there is no such module, it fails, or it may not run.
    """
    if trust == NAMED_NOW:
        name_now(text)
    elif trust == FROM_CONFIG:
        require_named("env", text)
    _import_module("env", text, gymnasium_name(text)[0] or "")


def trust_of(text: str) -> str:
    """Who has named something of the user's own: the user, only a config.json, or a program."""
    if text in _texts_named_now:
        return NAMED_NOW
    return FROM_CONFIG if text in _texts_from_config else BY_PROGRAM


def is_own(text: str) -> bool:
    """Whether a setting's value names something of the user's own."""
    return ":" in text or text.endswith(".py")


def absolute(text: str) -> str:
    """A name that holds in any working directory; of a module, as it is."""
    # os.path keeps symbolic links.
    return os.path.abspath(text) if ".py:" in text else text  # noqa: PTH100


def label(text: str) -> str:
    """A short name for files and titles: "point_mass-PointMass"."""
    if is_gymnasium(text):
        return text.rpartition(":")[2].replace("/", "-")
    place, _, attribute = text.rpartition(":")
    return f"{Path(place).name.removesuffix('.py')}-{attribute}" if place else text


def portable(text: str) -> str:
    """A name that is the same wherever a file lies: FILE.py:NAME without FILE's folder."""
    if not _is_file(text):
        return text
    place, _, attribute = text.rpartition(":")
    return f"{Path(place).name}:{attribute}"


def load_named(setting: str, text: str) -> Any:
    """Load the function or class that `text` names.

    Args:
        setting: its name, with which messages start.
        text: FILE.py:NAME or package.module:NAME.

    Raises:
        SettingError: there is no such file, module or name; it fails; or it may not run.
    """
    place, _, attribute = text.rpartition(":")
    if _is_file(text):
        file = _file(setting, text)
        with user_code(setting, place):
            module = load_file(file, _admitting(setting, text, file))
    else:
        module = _import_module(setting, text, place)
    try:
        found = operator.attrgetter(attribute)(module)
    except AttributeError:
        found = None
    if not callable(found):
        raise SettingError(f"{setting}: {place} has no function or class {attribute!r}")
    return found


def _import_module(setting: str, text: str, place: str) -> ModuleType:
    file = _file(setting, text)
    admit = _admitting(setting, text, file)
    with user_code(setting, place):
        admit(file, file.read_bytes())  # also if something has imported it already
        neighbours_of(folder_of(text).parent, admit, only=place.partition(".")[0])
        return importlib.import_module(place)


def files_of(text: str) -> dict[str, str]:
    """SHA-256 of the user's files that have run for `text`, by absolute path."""
    if is_gymnasium(text):
        return _hosted.get(text, {}).get("files", {})
    return run_files(folder_of(text))


def note_hosted(text: str, files: dict[str, str], versions: dict[str, str]) -> None:
    """Remember what an environment of Gymnasium's runs on, which is in another process.

    Args:
        text: the name.
        files: as `files_of` is to return them.
        versions: of packages, by name.
    """
    _hosted[text] = {"files": files, "versions": versions}


def hosted_versions(text: str) -> dict[str, str]:
    """Versions of packages that an environment of Gymnasium's runs on, by name."""
    return _hosted.get(text, {}).get("versions", {})


def folder_of(text: str) -> Path:
    """The folder of a named file; of a module, that of its top-level package.

    Raises:
        SettingError: there is no such file.
    """
    file, place = _file("", text), _place(text)
    if _is_file(text):
        return file.parent
    depth = place.count(".") + (file.name == "__init__.py")
    return file.parents[depth] / place.partition(".")[0] if depth else file


def name_now(text: str) -> None:
    """The user names something on the command line: it runs, and is remembered once it has run."""
    _texts_named_now.add(text)
    with contextlib.suppress(SettingError):  # loading it will say so
        _named_now.add(_file("", text))


def require_named(setting: str, text: str) -> None:
    """Check that what a config.json names may run, and let nothing else of it run from now on.

    Raises:
        SettingError: there is no such file; or the user has neither named it now nor, as it is now,
            before.
    """
    _texts_from_config.add(text)
    if is_gymnasium(text) and (trust_of(text) == NAMED_NOW or gymnasium_name(text)[0] is None):
        return  # it may be of another interpreter; or Gymnasium's registry has it
    try:
        file = _file(setting, text)
    except SettingError as error:
        why = "has moved or is another interpreter's" if is_gymnasium(text) else "has moved"
        raise SettingError(f"{error}; if it {why}, name it: {_option(setting, text)}") from None
    if file not in _named_now:
        _from_config.add(file)
        _admitting(setting, text, file)(file, _read(setting, file))


def _read(setting: str, file: Path) -> bytes:
    """What a file of code holds.

    Raises:
        SettingError: it cannot be read.
    """
    try:
        return file.read_bytes()
    except OSError as error:
        raise SettingError(f"{setting}: cannot read {file}: {error.strerror}") from None


def _admitting(setting: str, text: str, root: Path) -> Admit:
    """The rule for all files that run because `text` names `root`."""

    def admit(path: Path, data: bytes) -> None:
        if root in _named_now:
            allowed.remember(path, data)
        elif root in _from_config and not allowed.remembers(path, data):
            known = allowed.remembers_other(path)
            state = "has changed since you named it" if known else "was never named by you"
            raise SettingError(
                f"{setting}: {path} {state} on this machine, so it is not run; "
                f"if you trust it, name it: {_option(setting, text)}"
            )

    return admit


def _option(setting: str, text: str) -> str:
    return f"--{setting} {shlex.quote(text)}"


def _place(text: str) -> str:
    """The file or the module in a name."""
    return text.removeprefix(GYMNASIUM).rpartition(":")[0]


def _is_file(text: str) -> bool:
    place = _place(text)
    return place.endswith(".py") or os.sep in place


def _file(setting: str, text: str) -> Path:
    """The file that a name stands for, found without running anything.

    Raises:
        SettingError: there is none.
    """
    if is_gymnasium(text):
        return _file_of_module(setting, gymnasium_name(text)[0] or "gymnasium")
    place, _, attribute = text.rpartition(":")
    well_formed = text.isprintable() and all(part.isidentifier() for part in attribute.split("."))
    if not place or not well_formed:
        raise SettingError(f"{setting}: {text!r} is neither FILE.py:NAME nor package.module:NAME")
    if not _is_file(text):
        return _file_of_module(setting, place)
    if place.endswith(".py") and is_code(Path(place)):
        return Path(place).resolve()
    raise SettingError(f"{setting}: {text!r} is not FILE.py:NAME with a file that exists")


def _file_of_module(setting: str, module: str) -> Path:
    missing = SettingError(f"{setting}: there is no Python module {module!r} here")
    top, *parts = module.split(".")
    if not all(part.isidentifier() for part in (top, *parts)):
        raise missing
    try:
        spec = importlib.util.find_spec(top)
        name = top
        for part in parts:  # `find_spec` of a dotted name would run the packages around it
            name = f"{name}.{part}"
            locations = spec.submodule_search_locations if spec else None
            spec = PathFinder.find_spec(name, locations) if locations is not None else None
    except (ImportError, ValueError, AttributeError):
        raise missing from None
    if spec is None or spec.origin is None or not is_code(Path(spec.origin)):
        raise missing
    return Path(spec.origin).resolve()
