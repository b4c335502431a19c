"""Which files of Python code may run, on this machine, when it is not the user who names them now.

A run directory may come from anywhere, and its config.json names files. They run only if the user
has named them before, on a command line, and only with the bytes that they had then.

One small file per path and content, whose name is made of their SHA-256, as direnv has it: nothing
to lock, nothing to lose if two processes write at once, and no list that a crash could damage. It
holds the path, for people; and one that holds anything else does not count, since whoever can be
made to write something somewhere could be made to write it there.
"""

import contextlib
import os
from hashlib import sha256
from pathlib import Path


def remember(path: Path, data: bytes) -> None:
    """The user has named the file `path`, whose bytes are `data`.

    Where nothing can be kept (no home, a full or read-only disk), nothing is: the file will have to
    be named again.
    """
    if (folder := _folder()) is None or remembers(path, data):
        return
    with contextlib.suppress(OSError):
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        (folder / _entry(path, data)).write_bytes(_content(path))


def remembers(path: Path, data: bytes) -> bool:
    """Whether the user has named the file `path` when its bytes were `data`."""
    if (folder := _folder()) is None:
        return False
    entry = folder / _entry(path, data)
    try:
        return entry.is_file() and entry.read_bytes() == _content(path)
    except OSError:
        return False


def remembers_other(path: Path) -> bool:
    """Whether the user has named the file `path` with any bytes."""
    return (folder := _folder()) is not None and any(folder.glob(f"{_digest(_bytes(path))}-*"))


def _folder() -> Path | None:
    """Where entries lie, None without a home.

    Relative directories do not count, as the XDG specification has it: the working directory may
    be anybody's.
    """
    state = Path(os.environ.get("XDG_STATE_HOME", ""))
    if not state.is_absolute():
        try:
            home = Path.home()
        except RuntimeError:  # neither HOME nor an entry in passwd
            return None
        if os.environ.get("HOME") == "":  # Python takes that for the root directory
            return None
        state = home / ".local" / "state"
    return state / "cgm_jax" / "allowed" if state.is_absolute() else None


def _entry(path: Path, data: bytes) -> str:
    return f"{_digest(_bytes(path))}-{_digest(data)}"


def _content(path: Path) -> bytes:
    return f"{path}\n".encode(errors="backslashreplace")


def _bytes(path: Path) -> bytes:
    return os.fsencode(path)


def _digest(data: bytes) -> str:
    return sha256(data).hexdigest()
