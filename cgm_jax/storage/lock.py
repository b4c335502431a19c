"""One sweep at a time in a directory."""

import contextlib
import errno
import os
import socket
from collections.abc import Iterator
from datetime import datetime
from pathlib import Path

LOCK, HOLDER = "lock", "holder"
"""Two files, since some systems do not let others read a locked one."""

JOBS = {
    "SLURM_JOB_ID": "SLURM job",
    "PBS_JOBID": "PBS job",
    "LSB_JOBID": "LSF job",
    "JOB_ID": "job",
    "RAY_JOB_ID": "Ray job",
}
"""Variables by which batch systems tell a process its job."""

NO_LOCKS = (errno.ENOSYS, errno.ENOLCK, errno.EOPNOTSUPP, errno.EINVAL)
"""What file systems answer that cannot lock, as some network ones cannot."""


class InUseError(RuntimeError):
    """Another process trains in the directory; it is worth trying again later."""


@contextlib.contextmanager
def locked(directory: Path) -> Iterator[None]:
    """Hold a directory's lock for as long as the block runs.

    The operating system drops the lock of a process that ends, however it ends, so that no
    lock can be stale. Where it has no locks to offer, a marker file takes their place, which
    counts until its process has ended. A file beside it says who holds the lock.

    Raises:
        InUseError: another process holds it.
        OSError: the files cannot be written.
    """
    # Their import takes a moment, and evaluation needs no lock.
    from filelock import FileLock, SoftFileLock, Timeout

    holder = directory / HOLDER
    with contextlib.ExitStack() as stack:
        try:
            try:
                stack.enter_context(FileLock(directory / LOCK, timeout=0, fallback_to_soft=False))
            except (NotImplementedError, OSError) as error:
                if isinstance(error, OSError) and error.errno not in NO_LOCKS:
                    raise
                stack.enter_context(SoftFileLock(directory / f"{LOCK}.soft", timeout=0))
        except Timeout:
            raise InUseError(f"{directory} is in use by {_read(holder)}; try again later") from None
        holder.write_text(_this_process() + "\n")
        yield


def _this_process() -> str:
    now = datetime.now().isoformat(sep=" ", timespec="seconds")
    jobs = [f"{name} {os.environ[key]}, " for key, name in JOBS.items() if os.environ.get(key)]
    return f"{''.join(jobs[:1])}process {os.getpid()} on {socket.gethostname()} since {now}"


def _read(holder: Path) -> str:
    try:
        with holder.open(errors="replace") as file:
            return " ".join(file.read(200).split()) or "another process"
    except OSError:
        return "another process"
