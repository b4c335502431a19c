"""Files that are either whole or not there; and what to say of those that the system refuses."""

import contextlib
import errno
import os
import secrets
import time
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

PARTIAL = ".partial"
"""Ending of a file that is being written."""

ABANDONED_SECONDS = 600.0
"""After so long without a change nobody writes to a file any more, whatever two clocks say."""

ABSENT = (FileNotFoundError, NotADirectoryError)
"""What reading a file raises that is not there."""


DISK_FAULTS = (errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EIO, errno.ESTALE)
"""What the system answers where a disk is full, read-only, broken or away."""


class ReadError(OSError):
    """A file cannot be read just now, as on a network disk that is away; its bytes may be whole."""


@contextlib.contextmanager
def reading(path: Path) -> Iterator[None]:
    """Have what the system refuses in the block tell that it was reading, and what.

    Raises:
        ReadError: it has refused something.
        FileNotFoundError, NotADirectoryError: the file is not there.
    """
    try:
        yield
    except (*ABSENT, ReadError):
        raise
    except OSError as error:
        raise ReadError(error.errno, error.strerror or str(error), str(path)) from None


def refusal(error: OSError, directory: Path) -> str:
    """What the system has refused, in one line.

    Args:
        error: what it has raised.
        directory: in which all is written.
    """
    what = f"read {error.filename}" if isinstance(error, ReadError) else f"write to {directory}"
    return f"cannot {what}: {error.strerror or error}"


@contextlib.contextmanager
def replacing(path: Path, *, durable: bool = False) -> Iterator[BinaryIO]:
    """Write a file that takes the place of `path` in one step, once it is whole.

    A reader sees the old file or the new one, never a part. If the writing fails, the old file
    stays and nothing else is left behind. Of several that write it at once the last one counts.

    Args:
        path: the file to replace or create.
        durable: return only when the file would outlast a loss of power.

    Raises:
        OSError: the disk is full, the directory cannot be written to, ...
    """
    # A name that nobody else has, and "x", which follows no link.
    partial = path.with_name(f"{path.name}.{secrets.token_hex(4)}{PARTIAL}")
    file = partial.open("xb")
    try:
        with file:
            yield file
            if durable:
                file.flush()
                os.fsync(file.fileno())
        partial.replace(path)
        if durable:
            _synchronise(path.parent)
    except BaseException:
        with contextlib.suppress(OSError):
            partial.unlink(missing_ok=True)
        raise


def remove_partials(directory: Path, name: str = "") -> None:
    """Remove what killed processes have left half written, where nobody else writes now.

    Args:
        directory: in which.
        name: how the names of the files begin.
    """
    _remove(directory, name, before=None)


def remove_abandoned(path: Path) -> None:
    """Remove what killed processes have left of a file, which others may be writing as well."""
    _remove(path.parent, f"{path.name}.", before=time.time() - ABANDONED_SECONDS)


def _remove(directory: Path, name: str, before: float | None) -> None:
    """Remove files that are being written, if they were last changed before a time."""
    with contextlib.suppress(OSError):  # it is only tidying
        for path in list(directory.iterdir()):
            if not path.name.startswith(name) or path.suffix != PARTIAL:
                continue
            if before is None or path.lstat().st_mtime < before:
                path.unlink(missing_ok=True)


def _synchronise(directory: Path) -> None:
    """Bring the names in a directory to the disk: a rename is not there before."""
    try:
        descriptor = os.open(directory, os.O_RDONLY)
    except PermissionError:  # not on Windows, which has no such thing
        return
    try:
        os.fsync(descriptor)
    except OSError as error:
        if error.errno not in (errno.EINVAL, errno.EBADF, errno.EOPNOTSUPP):  # network disks
            raise
    finally:
        os.close(descriptor)
