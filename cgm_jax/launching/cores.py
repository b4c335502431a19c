"""Cores that no other attempt on this machine has, for engines that pin none themselves.

Neither Ray nor every SLURM sets an affinity, and a process that is not held to its cores takes as
many threads as the machine has. Which cores are taken is told by a lock per core, in a folder of
the user's own; the operating system drops the locks of a process that ends, however it ends.
"""

import contextlib
import os
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import IO


class Cores:
    """Some of this process's cores, claimed until `release`.

    Attributes:
        numbers: of the cores; empty where all may be used, or the system knows no affinity.
    """

    def __init__(self, count: int | None) -> None:
        """Claim `count` cores, if there are more of them than that; None claims none.

        Where too few are free the rest is shared with others.
        """
        self.numbers: list[int] = []
        self._locks: list[IO[str]] = []
        there = sorted(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else []
        if count is None or len(there) <= count:
            return
        for core in there:
            if len(self.numbers) < count and (lock := _lock(core)) is not None:
                self.numbers.append(core)
                self._locks.append(lock)
        others = [core for core in there if core not in self.numbers]
        self.numbers += others[: count - len(self.numbers)]

    @contextlib.contextmanager
    def inherited(self) -> Iterator[None]:
        """Children that are started in the block are held to these cores."""
        if not self.numbers:
            yield
            return
        before = os.sched_getaffinity(0)
        os.sched_setaffinity(0, self.numbers)
        try:
            yield
        finally:
            os.sched_setaffinity(0, before)

    def release(self) -> None:
        """Leave the cores to others."""
        for lock in self._locks:
            lock.close()
        self._locks = []


def _lock(core: int) -> IO[str] | None:
    """A core's lock, held as long as the file is open; None if somebody else holds it."""
    try:
        import fcntl

        folder = Path(tempfile.gettempdir()) / f"cgm_jax-cores-{os.getuid()}"
        folder.mkdir(mode=0o700, exist_ok=True)
        if folder.is_symlink() or folder.stat().st_uid != os.getuid():
            return None
        file = (folder / str(core)).open("w")
    except (ImportError, OSError):
        return None
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        file.close()
        return None
    return file
