"""A sweep in a process of its own that runs one epoch at a time, and what each epoch takes."""

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn, Self

from cgm_jax.config.fields import SettingError
from cgm_jax.config.spelling import counted
from cgm_jax.host.exit_codes import ExitCode
from cgm_jax.measuring.checkouts import Checkout
from cgm_jax.measuring.child import MeasurementError, last_line

POLL_SECONDS = 0.005
TICKS_PER_SECOND = os.sysconf("SC_CLK_TCK")


@dataclass(frozen=True)
class Cost:
    """What a stretch of training took.

    Attributes:
        wall_s: seconds during which the process was allowed to run.
        cpu_s: CPU seconds of all its threads, in user and system mode.
        env_steps: environment steps of each run, training only.
    """

    wall_s: float
    cpu_s: float
    env_steps: int


class TrainingProcess:
    """A sweep of a checkout, from its start to the end of the block.

    Between two calls of `train_epoch` the process is paused, so that another one can have the
    machine; its memory stays. Its own clock runs on meanwhile, so time is taken here instead of
    from `wall_s`. It compiles everything anew. Known of the checkout are only its command line
    and `epoch` and `env_steps` in metrics.jsonl.
    """

    def __init__(self, checkout: Checkout, options: Sequence[str], directory: Path) -> None:
        """Prepare `python -m cgm_jax.sweep` with options; it writes into `directory`."""
        self._checkout = checkout
        self._options = options
        self._directory = directory
        self._metrics = directory / "sweep" / "metrics.jsonl"
        self._epoch = 0
        self._env_steps = 0
        self._cpu_s = 0.0

    def __enter__(self) -> Self:
        self._directory.mkdir()
        cache = {"JAX_COMPILATION_CACHE_DIR": str(self._directory / "cache")}
        out = ["--out", str(self._metrics.parent)]
        with (
            (self._directory / "stdout").open("w") as stdout,
            (self._directory / "stderr").open("w") as stderr,
        ):
            self._resumed = time.monotonic()
            self._process = subprocess.Popen(
                [sys.executable, "-m", "cgm_jax.sweep", *self._options, *out],
                cwd=self._checkout.root,
                env={**self._checkout.environment(), **cache},
                stdin=subprocess.DEVNULL,
                stdout=stdout,
                stderr=stderr,
                # Signals of the terminal are for us. If we are killed while it is paused, its
                # group is orphaned and the system ends it with SIGHUP.
                process_group=0,
            )
        return self

    def __exit__(self, *_: object) -> None:
        if self._process.poll() is None:
            os.killpg(self._process.pid, signal.SIGKILL)
            self._process.wait()

    def train_epoch(self) -> Cost:
        """Run until a further epoch is in metrics.jsonl, then pause.

        The first call includes the start. Epochs that are over before the first is noticed
        count as one.

        Raises:
            MeasurementError: there are no further epochs, or the process has failed.
            SettingError: it has refused its options.
        """
        if self._epoch:
            self._resumed = time.monotonic()
            os.killpg(self._process.pid, signal.SIGCONT)
        row = self._wait_for_row()
        wall_s, cpu_s = self._pause()
        cost = Cost(wall_s, cpu_s - self._cpu_s, row["env_steps"] - self._env_steps)
        self._epoch, self._env_steps, self._cpu_s = row["epoch"], row["env_steps"], cpu_s
        return cost

    def runs(self) -> int:
        """How many runs train side by side, known after two epochs."""
        rows = self._rows()
        return sum(row["epoch"] == rows[0]["epoch"] for row in rows)

    def _pause(self) -> tuple[float, float]:
        """Pause; wall seconds since it was resumed, and CPU seconds since it was started."""
        os.killpg(self._process.pid, signal.SIGSTOP)
        wall_s = time.monotonic() - self._resumed
        while True:
            state, cpu_s = process_times(self._process.pid)
            if state in "TZ":  # it may end with the epoch; why, the next call says
                return wall_s, cpu_s
            time.sleep(POLL_SECONDS / 10)

    def _ended(self) -> bool:
        """Whether the process has; it stays a zombie, which can be signalled and read about."""
        options = os.WEXITED | os.WNOHANG | os.WNOWAIT
        return os.waitid(os.P_PID, self._process.pid, options) is not None

    def _wait_for_row(self) -> dict[str, Any]:
        """The last row of metrics.jsonl, once it is of a further epoch."""
        seen = 0
        while True:
            ended = self._ended()  # before the rows: the last of them may come with the end
            size = self._metrics.stat().st_size if self._metrics.exists() else 0
            if size != seen and (rows := self._rows()):
                if rows[-1]["epoch"] > self._epoch:
                    return rows[-1]
                if rows[-1]["epoch"] < self._epoch:  # it has moved on to other runs
                    self._give_up(ExitCode.DONE)
            if ended:
                self._give_up(self._process.wait())
            seen = size
            time.sleep(POLL_SECONDS)

    def _give_up(self, code: int) -> NoReturn:
        """Say why there are no further epochs of the same runs."""
        said = last_line((self._directory / "stderr").read_text())
        where = f"{' '.join(['cgm_jax.sweep', *self._options])} at {self._checkout.commit}"
        if code == ExitCode.BAD_INPUT:
            raise SettingError(f"options: {where}: {said.removeprefix('error: ')}")
        if code == ExitCode.DONE:
            raise MeasurementError(
                f"{where} trains its runs side by side for {counted(self._epoch, 'epoch')} only; "
                "give it more --epochs, or time fewer"
            )
        raise MeasurementError(f"{where} ended with exit code {code}: {said}")

    def _rows(self) -> list[dict[str, Any]]:
        """All whole lines of metrics.jsonl."""
        lines = self._metrics.read_text().splitlines(keepends=True)
        return [json.loads(line) for line in lines if line.endswith("\n")]


def process_times(pid: int) -> tuple[str, float]:
    """State of a process (R, S, T, Z ...), and the CPU seconds of it and its ended children."""
    text = Path(f"/proc/{pid}/stat").read_text()
    fields = text.rpartition(")")[2].split()  # the name before it may hold anything
    return fields[0], sum(int(ticks) for ticks in fields[11:15]) / TICKS_PER_SECOND
