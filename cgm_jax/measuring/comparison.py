"""This checkout against another commit: what training and its start take.

A round is one process of each side, which run in turn: A starts, B starts, then epochs A B B A
A B ... The two of a pair are seconds apart, so that whatever else the machine does strikes
both. What differs between processes of the same program (where its memory and threads lie)
differs between rounds; so the interval comes from one ratio per round, not per epoch.
"""

import math
import shlex
import sys
import tempfile
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from cgm_jax.config.fields import SettingError
from cgm_jax.measuring.checkouts import Checkout, find_commit, prepare, this_checkout, worktree
from cgm_jax.measuring.child import MeasurementError
from cgm_jax.measuring.ratios import Ratio, paired_ratio
from cgm_jax.measuring.training_process import Cost, TrainingProcess
from cgm_jax.measuring.unwinding import Unwinding

TRAINING_BOUND = 1.03
START_BOUND = 1.10


@dataclass(frozen=True)
class Side:
    """One of the two that are compared: a checkout and the options of its sweep."""

    checkout: Checkout
    options: tuple[str, ...]


@dataclass(frozen=True)
class Measurement:
    """What one process took; each value above 0.

    Attributes:
        training_wall, training_cpu: milliseconds per run and 1,000 environment steps of
            training, with the evaluations that belong to them.
        start_wall, start_cpu: seconds from the command to the end of the first epoch, less what
            an epoch takes later: imports, tracing and compilation.
    """

    training_wall: float
    training_cpu: float
    start_wall: float
    start_cpu: float


@dataclass(frozen=True)
class Comparison:
    """One figure of both sides: geometric means over rounds, and their ratio."""

    name: str
    this: float
    other: float
    ratio: Ratio
    bound: float

    def row(self) -> tuple[str, ...]:
        """Name, both values, ratio, interval, and bound with verdict, as text."""
        ratio = self.ratio
        return (
            self.name,
            f"{self.this:.4g}",
            f"{self.other:.4g}",
            f"{ratio.value:.3f}",
            f"{ratio.low:.3f}-{ratio.high:.3f}",
            f"{self.bound:.2f} {ratio.verdict(self.bound)}",
        )


def check_options(name: str, options: Sequence[str]) -> tuple[str, ...]:
    """The same options.

    Raises:
        SettingError: one of them is ours to give.
    """
    for option in options:
        if option.partition("=")[0] in ("--out", "--resume"):
            raise SettingError(f"{name}: {option} is for the benchmark to choose")
    return tuple(options)


def parse_options(name: str, text: str) -> tuple[str, ...]:
    """The options of a sweep from one line of text.

    Raises:
        SettingError: a quotation is not closed, or one of them is ours to give.
    """
    try:
        options = shlex.split(text)
    except ValueError as error:
        raise SettingError(f"{name}: {str(error).lower()} in {text!r}") from None
    return check_options(name, options)


def compare(
    against: str, options: Sequence[str], against_options: Sequence[str], rounds: int, epochs: int
) -> tuple[list[Side], list[Comparison]]:
    """Compare this checkout with a commit.

    Args:
        against: names the commit.
        options: of this checkout's sweep.
        against_options: of the other's.
        rounds: pairs of processes, at least 2.
        epochs: timed in each process after its first.

    Returns:
        This side and the other; and the comparisons.

    Raises:
        SettingError: there is no such commit, this is no clean git checkout, or a sweep refuses
            its options.
        MeasurementError: a sweep ends too early.
    """
    if not Path("/proc/self/stat").exists():
        raise SettingError("against: needs Linux, whose /proc tells a process's CPU time")
    this = this_checkout()
    commit = find_commit(this.root, against)
    with (
        Unwinding() as unwinding,
        unwinding.held(tempfile.TemporaryDirectory(prefix="cgm_jax-benchmark-")) as directory,
        unwinding.held(worktree(this.root, commit, Path(directory) / commit)) as other,
    ):
        sides = [Side(this, tuple(options)), Side(other, tuple(against_options))]
        for side in sides:
            prepare(side.checkout)
        measured: list[list[Measurement]] = []
        for number in range(rounds):
            order = (0, 1) if number % 2 == 0 else (1, 0)
            with unwinding.held(tempfile.TemporaryDirectory(dir=directory)) as scratch:
                taken = _measure_round(
                    [sides[index] for index in order], epochs, Path(scratch), unwinding
                )
            measured.append([taken[index] for index in order])  # its own inverse
            print(_describe_round(number + 1, rounds, *measured[-1]), file=sys.stderr)
        return sides, _comparisons(measured)


def _measure_round(
    sides: Sequence[Side], epochs: int, directory: Path, unwinding: Unwinding
) -> list[Measurement]:
    """One process for each side, in turn."""
    with ExitStack() as stack:
        processes, first = [], []
        for i, side in enumerate(sides):
            process = TrainingProcess(side.checkout, side.options, directory / str(i))
            processes.append(stack.enter_context(unwinding.held(process)))
            first.append(process.train_epoch())
        later: list[list[Cost]] = [[] for _ in sides]
        for epoch in range(epochs):
            for i in (0, 1) if epoch % 2 == 0 else (1, 0):
                later[i].append(processes[i].train_epoch())
        return [
            measurement(first[i], later[i], process.runs()) for i, process in enumerate(processes)
        ]


def measurement(first: Cost, later: Sequence[Cost], runs: int) -> Measurement:
    """What a process took, from its first epoch and those after it.

    Args:
        first: from the command to the end of the first epoch.
        later: of each epoch after it.
        runs: that share what the process takes.

    Raises:
        MeasurementError: it is too little for the clock.
    """
    steps = sum(cost.env_steps for cost in later)
    wall = sum(cost.wall_s for cost in later) / steps
    cpu = sum(cost.cpu_s for cost in later) / steps
    taken = Measurement(
        training_wall=1e6 * wall / runs,
        training_cpu=1e6 * cpu / runs,
        start_wall=first.wall_s - wall * first.env_steps,
        start_cpu=first.cpu_s - cpu * first.env_steps,
    )
    if min(vars(taken).values()) <= 0:
        raise MeasurementError("epochs too short for the clock; give them more cycles")
    return taken


def _comparisons(measured: Sequence[Sequence[Measurement]]) -> list[Comparison]:
    """Compare all rounds [rounds, 2]."""

    def compared(name: str, field: str, bound: float) -> Comparison:
        pairs = [[getattr(taken, field) for taken in pair] for pair in measured]
        ones, others = zip(*pairs, strict=True)
        this, other = (math.exp(np.log(values).mean()) for values in (ones, others))
        return Comparison(name, this, other, paired_ratio(ones, others), bound)

    return [
        compared("training, CPU ms", "training_cpu", TRAINING_BOUND),
        compared("training, wall ms", "training_wall", TRAINING_BOUND),
        compared("start, CPU s", "start_cpu", START_BOUND),
        compared("start, wall s", "start_wall", START_BOUND),
    ]


def _describe_round(number: int, rounds: int, this: Measurement, other: Measurement) -> str:
    ratios = [getattr(this, name) / getattr(other, name) for name in vars(this)]
    wall, cpu, start_wall, start_cpu = (f"{ratio:.3f}" for ratio in ratios)
    return (
        f"round {number} of {rounds}: training {cpu} of the CPU time and {wall} of the wall time, "
        f"start {start_cpu} and {start_wall}"
    )
