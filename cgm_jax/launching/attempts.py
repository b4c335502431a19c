"""One attempt at a part: a child process from its start to its end, and whether to try again.

`python -m cgm_jax.launching.attempts ORDER` makes one, for engines that start processes. Only the
standard library is imported, and no JAX, since an attempt has little memory of its own.
"""

import contextlib
import json
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from enum import Enum
from pathlib import Path
from types import FrameType
from typing import IO

from cgm_jax.host.exit_codes import FINISHED, ExitCode
from cgm_jax.launching.cores import Cores
from cgm_jax.launching.record import append_event, position
from cgm_jax.storage.lock import InUseError, locked

MAX_FRUITLESS = 5
"""Attempts in a row that begin at the same checkpoint, after which none is made."""

LOCK_PATIENCE = 300.0
"""Seconds that an attempt waits for one before it that still trains, on a node believed lost."""

ELSEWHERE = os.sep
"""Where a child starts if the directory that it should start in is not there. Python imports from
the working directory, so it must be one that other users cannot write to."""

POLL_SECONDS = 0.2
ENDING_SECONDS = 20.0
"""From SIGTERM to the end of a child, at most; a sweep takes ten."""

ENDING_WITH_PARENT = """
import ctypes, os, signal, sys
ctypes.CDLL(None).prctl(1, signal.SIGTERM)
if os.getppid() != int(sys.argv[1]):
    sys.exit(75)
os.execv(sys.argv[2], sys.argv[2:])
"""
"""Becomes another program, which gets SIGTERM when whoever started it ends, however it ends.

That is PR_SET_PDEATHSIG of Linux. Elsewhere a child outlives a parent that is killed, and the next
attempt waits for it.
"""


class Step(Enum):
    """What becomes of a part after an attempt."""

    DONE = "done"
    AGAIN = "again"
    FAILED = "failed"


def next_step(code: int | None, fruitless: int) -> Step:
    """What to do after an attempt.

    Whatever ended it from outside (a signal, a lost node, a full disk, a lock that is held) is
    tried again, but not for ever; what the sweep itself says of its input or its failure is not.

    Args:
        code: exit code; negative or above 128 for a signal; None for none, where a node was lost.
        fruitless: attempts in a row, this one included, that began where training stands now.
    """
    if code in FINISHED:
        return Step.DONE
    killed = code is None or was_killed(code)
    if not killed and code not in (ExitCode.CANNOT_WRITE, ExitCode.STOPPED):
        return Step.FAILED
    return Step.AGAIN if fruitless < MAX_FRUITLESS else Step.FAILED


def was_killed(code: int) -> bool:
    """Whether an exit code says that a signal ended the process; shells add 128 to its number."""
    return code < 0 or code > 128


@dataclass(frozen=True)
class Order:
    """All that an attempt needs to know, on whichever machine it is made.

    Attributes:
        command: of the child; the same at every attempt.
        out: the part's run directory.
        record: file of its attempts.
        log: file of the child's output.
        cwd: directory in which the child starts, if it is there; else that is `ELSEWHERE`.
        cores: how many to hold the child to; None for all.
        environment: variables to add to those of the machine.
        session: whether the child gets a session of its own, apart from the terminal's signals.
    """

    command: Sequence[str]
    out: str
    record: str
    log: str
    cwd: str
    cores: int | None
    environment: Mapping[str, str]
    session: bool = False

    def to_json(self) -> str:
        """As text, for `from_json`."""
        return json.dumps(asdict(self))

    @classmethod
    def from_json(cls, text: str) -> "Order":
        """The inverse of `to_json`."""
        return cls(**json.loads(text))


class Attempt:
    """A child process, looked after without ever waiting for it.

    Waiting in a signal handler, as batch systems make one do, would block for good.
    """

    def __init__(self, order: Order, job: str = "") -> None:
        """Begin; the child starts with the first `poll` that finds nobody else in its directory."""
        self._order, self._job = order, job
        self._out, self._record = Path(order.out), Path(order.record)
        self._patient_until = time.monotonic() + LOCK_PATIENCE
        self._child: subprocess.Popen[bytes] | None = None
        self._cores: Cores | None = None
        self._stopping = False
        self._code: int | None = None

    def poll(self) -> int | None:
        """Look after the child; return its exit code once it has ended."""
        if self._code is not None:
            return self._code
        if self._child is not None:
            code = self._child.poll()
            return None if code is None else self._end(code)
        if self._stopping:
            return self._end(ExitCode.STOPPED)
        if not _in_use(self._out):
            self._start()
        elif time.monotonic() > self._patient_until:
            self._begun()
            return self._end(ExitCode.IN_USE)
        return None

    def stop(self) -> None:
        """Ask the child to end with a checkpoint: SIGTERM, exactly once."""
        if not self._stopping:
            self._stopping = True
            if self._child is not None and self._child.poll() is None:
                self._child.terminate()

    def run(self, parent: int | None = None) -> int:
        """Poll until the end; if the process `parent` goes away before that, stop.

        Returns:
            The exit code.
        """
        while (code := self.poll()) is None:
            if parent is not None and os.getppid() != parent:
                self.stop()
            time.sleep(POLL_SECONDS)
        return code

    def finish(self) -> int | None:
        """After `stop`: poll until the end, but not for long."""
        deadline = time.monotonic() + ENDING_SECONDS
        while (code := self.poll()) is None and time.monotonic() < deadline:
            time.sleep(POLL_SECONDS)
        return code

    def _start(self) -> None:
        order = self._order
        self._begun()
        self._cores = Cores(order.cores)
        try:
            with _log(order.log) as log, self._cores.inherited(), _warnings_blocked():
                self._child = subprocess.Popen(
                    _ending_with_this_process(order.command),
                    stdin=subprocess.DEVNULL,
                    stdout=log,
                    stderr=log,
                    cwd=order.cwd if os.path.isdir(order.cwd) else ELSEWHERE,  # noqa: PTH112
                    env={**os.environ, **order.environment},
                    start_new_session=order.session,
                )
            if self._stopping:  # which has become so just now
                self._child.terminate()
        except OSError as error:  # no interpreter on this machine, for one
            append_event(self._record, "failed", reason=str(error))
            self._end(ExitCode.FAILED)

    def _begun(self) -> None:
        append_event(
            self._record,
            "started",
            position=position(self._out),
            host=socket.gethostname(),
            process=os.getpid(),
            job=self._job,
        )

    def _end(self, code: int) -> int:
        self._code = int(code)
        if self._cores is not None:
            self._cores.release()
        append_event(self._record, "ended", code=self._code, position=position(self._out))
        return self._code


def _ending_with_this_process(command: Sequence[str]) -> list[str]:
    if not sys.platform.startswith("linux"):
        return list(command)
    python = [sys.executable, "-I", "-S", "-c", ENDING_WITH_PARENT]
    return [*python, str(os.getpid()), *command]


def _in_use(out: Path) -> bool:
    """Whether a process, on whichever machine, trains in a directory."""
    try:
        if out.is_dir():
            with locked(out):
                pass
    except InUseError:
        return True
    except OSError:  # the sweep itself will say what is wrong
        pass
    return False


@contextlib.contextmanager
def _log(path: str) -> Iterator[IO[bytes] | int]:
    """A file for output; on a full disk there is none, and training goes on."""
    try:
        file = Path(path).open("ab")  # noqa: SIM115
    except OSError:
        yield subprocess.DEVNULL
        return
    with file:
        yield file


@contextlib.contextmanager
def _warnings_blocked() -> Iterator[None]:
    """Children started in the block never see SIGUSR1 and SIGUSR2.

    Batch systems send these to every process of a job, and whoever looks after a child passes
    SIGTERM on instead. A blocked signal stays blocked in the child.
    """
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGUSR1, signal.SIGUSR2})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def main(text: str) -> int:
    """Make one attempt, as a process that an engine has started and may end."""
    attempt = Attempt(Order.from_json(text))

    def stop(number: int, frame: FrameType | None) -> None:
        del number, frame
        attempt.stop()

    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, stop)
    code = attempt.run(parent=os.getppid())
    return code if code >= 0 else 128 - code  # as a shell tells of a signal


if __name__ == "__main__":
    sys.exit(main(sys.argv[1]))
