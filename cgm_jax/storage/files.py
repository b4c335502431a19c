"""Files that are either whole or not there."""

import contextlib
import errno
import os
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

PARTIAL = ".partial"
"""Ending of a file that is being written."""


@contextlib.contextmanager
def replacing(path: Path, *, durable: bool = False) -> Iterator[BinaryIO]:
    """Write a file that takes the place of `path` in one step, once it is whole.

    A reader sees the old file or the new one, never a part. If the writing fails, the old file
    stays and nothing else is left behind.

    Args:
        path: the file to replace or create.
        durable: return only when the file would outlast a loss of power.

    Raises:
        OSError: the disk is full, the directory cannot be written to, ...
    """
    partial = path.with_name(path.name + PARTIAL)
    try:
        partial.unlink(missing_ok=True)  # of a killed process; or a link that leads elsewhere
        with partial.open("xb") as file:
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
