"""What a program shows while it runs."""

import math
import statistics
import sys
import time
from collections.abc import Mapping, Sequence
from fractions import Fraction
from typing import Any, Self

import numpy as np
from rich.columns import Columns
from rich.console import Console, Group
from rich.live import Live
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.text import Text


class SteadyConsole(Console):
    """A console on standard error that never hides the cursor.

    So a process that is killed cannot leave it hidden, and nobody needs to bring it back.
    """

    def __init__(self) -> None:
        super().__init__(stderr=True)

    def show_cursor(self, show: bool = True) -> bool:
        """Do nothing, and say so."""
        del show
        return False

    @property
    def can_redraw(self) -> bool:
        """Whether there is a terminal, which FORCE_COLOR, for one, does not make."""
        return self.is_terminal and self.file.isatty() and not self.is_dumb_terminal


class SweepProgress:
    """A bar with ETA and environment steps/s, and the success of every run so far.

    On a terminal it is redrawn in place; elsewhere there is one line per epoch.
    """

    def __init__(self, cycles: int | None = None) -> None:
        """Expect `cycles` cycles, summed over the groups of the sweep; None if not known yet."""
        self._console = SteadyConsole()
        self._redraws = self._console.can_redraw
        self._bar = Progress(
            TextColumn("{task.description}"),
            BarColumn(),
            TextColumn("{task.percentage:3.0f} %"),
            TimeElapsedColumn(),
            TextColumn("ETA"),
            TimeRemainingColumn(elapsed_when_finished=False, compact=True),
            TextColumn("{task.fields[speed]}"),
            console=self._console,
        )
        self._task = self._bar.add_task("compiling", total=cycles, speed="")
        self._live = Live(self._bar, console=self._console, refresh_per_second=2)
        self._success: dict[str, float] = {}
        self._started = time.monotonic()
        self._done = Fraction(0)

    def __enter__(self) -> Self:
        if self._redraws:
            self._live.start(refresh=True)
        return self

    def __exit__(self, *_: object) -> None:
        if self._redraws:
            if self._bar.tasks[0].total is None:  # refused: nothing has been begun
                self._live.update(Text())
            elif self._bar.finished:  # a summary comes that lists all runs; once is enough
                self._live.update(self._bar)
            self._live.stop()

    def expect(self, cycles: int) -> None:
        """So many cycles are to be done, summed over the groups of the sweep."""
        self._bar.update(self._task, total=cycles)

    def compiling(self) -> None:
        """What comes next has to be compiled first, which takes longer than a chunk."""
        self._bar.update(self._task, description="compiling", speed="")

    def skip(self, cycles: int | Fraction) -> None:
        """So many cycles were done in an earlier process, or need not be done."""
        self._done += cycles
        self._bar.update(self._task, completed=float(self._done))

    def advance(self, cycles: int | Fraction) -> None:
        """A chunk is done: so many cycles, or so much of one."""
        self.skip(cycles)
        self._bar.update(self._task, description="training")

    def show_speed(self, env_steps: int, seconds: float) -> None:
        """So many environment steps over all runs, updates included, took so long."""
        self._bar.update(self._task, speed=f"{env_steps / seconds:,.0f} environment steps/s")

    def seconds(self) -> float:
        """Since this was made, before anything compiled."""
        return time.monotonic() - self._started

    def epoch(self, epoch: int, rows: Sequence[Mapping[str, Any]]) -> None:
        """An epoch is done: its rows of metrics.jsonl."""
        success = {row["run"]: success_of(row) for row in rows}
        self._success.update(success)
        if self._redraws:
            self._list_runs()
        else:
            rates = sorted(rate for rate in success.values() if math.isfinite(rate)) or [math.nan]
            print(
                f"epoch {epoch}: {rows[0]['env_steps']:,} environment steps, "
                f"{_success_of_all(rates)}, {self.seconds():.0f} s",
                file=sys.stderr,
                flush=True,
            )

    def _list_runs(self) -> None:
        rows = [
            Text(f"{name} {_percent(rate)}", style="green" if rate >= 0.5 else "")
            for name, rate in self._success.items()
        ]
        self._live.update(Group(self._bar, Columns(rows, padding=(0, 3))))


class CountProgress:
    """How many of something are done: a bar on a terminal; elsewhere a line now and then."""

    FIRST_LINE, LINES = 5.0, 15.0
    """Seconds until the first line, and between lines: what is short prints none."""

    def __init__(self, unit: str) -> None:
        """Count things that are called `unit`, such as episodes."""
        console = SteadyConsole()
        self._redraws = console.can_redraw
        self._unit = unit
        self._bar = Progress(
            TextColumn(f"{{task.completed:,.0f}} of {{task.total:,.0f}} {unit}"),
            BarColumn(),
            TimeElapsedColumn(),
            TextColumn("ETA"),
            TimeRemainingColumn(compact=True),
            console=console,
            transient=True,
            disable=not self._redraws,
        )
        self._task = self._bar.add_task("", total=1, visible=False)
        self._next_line = time.monotonic() + self.FIRST_LINE

    def __enter__(self) -> Self:
        self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._bar.stop()

    def show(self, done: int, total: int) -> None:
        """So many of so many are done."""
        self._bar.update(self._task, completed=done, total=total, visible=True)
        if not self._redraws and time.monotonic() >= self._next_line:
            self._next_line = time.monotonic() + self.LINES
            print(f"{done:,} of {total:,} {self._unit}", file=sys.stderr, flush=True)


def _percent(rate: float) -> str:
    return f"{100 * rate:.0f} %" if math.isfinite(rate) else "no valid episode"


def success_of(row: Mapping[str, Any]) -> float:
    """The success rate in a row of metrics.jsonl; NaN where there was no valid episode."""
    return math.nan if row["success_rate"] is None else row["success_rate"]


def _success_of_all(rates: Sequence[float]) -> str:
    """The success of runs, in order of size, on a line."""
    if len(rates) == 1:
        return f"success {_percent(rates[0])}"
    spread = f"({_percent(rates[0])} to {_percent(rates[-1])})"
    return f"success median {_percent(statistics.median(rates))} of {len(rates)} runs {spread}"


def summary_lines(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """Final success per run, best first, from the last row of each."""
    ordered = sorted(rows, key=lambda row: -np.nan_to_num(success_of(row)))
    width = max(len(row["run"]) for row in rows)
    lines = []
    for row in ordered:
        line = f"{row['run']:{width}}  {_percent(success_of(row)):>5}"
        if row["failure"] is not None:
            line += f"  diverged in epoch {row['failed_epoch']}: {row['failure']}"
        lines.append(line)
    return lines


def physics_lines(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """How many episodes broken physics cost, from the rows of metrics.jsonl; no line if none."""
    dropped: dict[str, int] = {}
    for row in rows:
        dropped[row["run"]] = dropped.get(row["run"], 0) + int(row["physics_warnings"])
    if not (total := sum(dropped.values())):
        return []
    worst = max(dropped, key=lambda run: dropped[run])
    return [f"physics broke in {total} episodes, which were dropped; most in {worst}"]
