"""Standard output and standard error that never fail.

A reader that goes away (`| head`), a terminal that is closed or stopped, a full disk behind `>`,
descriptors closed at the start (`>&-`): none of them may end training, hold it up, or change an
exit code. Output that nobody takes is dropped.
"""

import contextlib
import errno
import io
import os
import select
import sys
from typing import Any

STALLED_SECONDS = 2.0
"""How long standard error waits for a reader that has stopped reading."""

PIECE = getattr(select, "PIPE_BUF", 512)
"""Bytes that can be written without waiting once a descriptor is ready."""


def make_streams_harmless() -> None:
    """Replace this process's standard streams by ones that cannot fail.

    Standard error, which training writes to, waits at most two seconds for its reader. Standard
    output, which holds results, waits for as long as the reader lives, as any program's does.
    Streams that somebody has put in the place of Python's own are left alone.
    """
    _open_missing_descriptors()
    if sys.stdout is sys.__stdout__:
        sys.stdout = _harmless(sys.stdout, 1, patience=None)
    if sys.stderr is sys.__stderr__:
        sys.stderr = _harmless(sys.stderr, 2, patience=STALLED_SECONDS)


def write_directly(text: str) -> None:
    """Write to standard error past all buffers and locks, as the last words of a process."""
    HarmlessDescriptor(2, STALLED_SECONDS).write(text.encode(errors="backslashreplace"))


class HarmlessDescriptor(io.RawIOBase):
    """A file descriptor to write to, where what cannot be written is dropped."""

    def __init__(self, descriptor: int, patience: float | None) -> None:
        """Write to `descriptor`, waiting `patience` seconds for its reader; None: for ever."""
        self._descriptor = descriptor
        self._patience = patience
        self._wait = patience

    def writable(self) -> bool:
        """Always."""
        return True

    def fileno(self) -> int:
        """The descriptor."""
        return self._descriptor

    def isatty(self) -> bool:
        """Whether it is a terminal."""
        return os.isatty(self._descriptor)

    def write(self, data: Any) -> int:
        """Write or drop everything; return its size in bytes."""
        rest = memoryview(data).cast("B")
        size = rest.nbytes
        with contextlib.suppress(OSError):
            while rest and self._is_ready():
                rest = rest[os.write(self._descriptor, rest[:PIECE]) :]
        return size

    def _is_ready(self) -> bool:
        """Whether a piece can be written; once a reader has stalled, it is not waited for again."""
        if not hasattr(select, "poll"):
            return True
        poll = select.poll()
        poll.register(self._descriptor, select.POLLOUT)
        ready = bool(poll.poll(None if self._wait is None else 1000 * self._wait))
        self._wait = self._patience if ready else 0.0
        return ready


def _harmless(stream: Any, descriptor: int, patience: float | None) -> io.TextIOWrapper:
    """A text stream over a descriptor, that writes what an encoding lacks as an escape."""
    return io.TextIOWrapper(
        io.BufferedWriter(HarmlessDescriptor(descriptor, patience)),
        encoding=getattr(stream, "encoding", None) or "utf-8",
        errors="backslashreplace",
        line_buffering=True,
    )


def _open_missing_descriptors() -> None:
    """Put the null device where a standard descriptor is closed.

    Otherwise the next file to be opened, such as a checkpoint, would get its number, and all that
    libraries write to standard error.
    """
    for descriptor in range(3):
        try:
            os.fstat(descriptor)
        except OSError as error:
            if error.errno != errno.EBADF:
                continue
            null = os.open(os.devnull, os.O_RDWR)
            if null != descriptor:
                os.dup2(null, descriptor)
                os.close(null)
            os.set_inheritable(descriptor, True)
