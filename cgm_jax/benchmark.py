"""`python -m cgm_jax.benchmark`: how far the trainer is from what the machine can do.

Every figure is a ratio of two measurements of one process, taken in turn, so that a slow or
busy machine changes both. Nothing else should run meanwhile.
"""

import os
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from rich.console import Console
from rich.table import Table

from cgm_jax.host.command_line import parse, run_program
from cgm_jax.host.startup import prepare_jax
from cgm_jax.measuring.figures import Figure
from cgm_jax.measuring.start import first_step, measure_starts
from cgm_jax.settings import SettingError


@dataclass(kw_only=True)
class BenchmarkOptions:
    """Measure rollouts, updates, sweeps and the start, as ratios."""

    part: Literal["all", "first-step"] = "all"
    """first-step: only start, take one training step, and exit."""

    repeats: int = 5
    """Measurements per figure; the median counts."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the program on command-line arguments; return its exit code."""
    options = parse(BenchmarkOptions, arguments, "python -m cgm_jax.benchmark")
    if not 1 <= options.repeats <= 1000:
        raise SettingError(f"repeats: {options.repeats} is not within [1, 1000]")
    if options.part == "first-step":
        prepare_jax()
        first_step()
        return 0
    table = Table("measured", "value", "target", title=f"{os.cpu_count()} cores")
    for figure in _measure(options.repeats):
        table.add_row(*figure.row())
    Console().print(table)
    return 0


def _measure(repeats: int) -> list[Figure]:
    # Before anything else runs: a process of its own each.
    starts = measure_starts()
    prepare_jax()  # ahead of what imports JAX
    from cgm_jax.measuring.rollouts import measure_rollouts
    from cgm_jax.measuring.sweeps import measure_sweep
    from cgm_jax.measuring.updates import measure_updates

    return [
        *starts,
        *measure_rollouts(repeats),
        *measure_updates(repeats),
        *measure_sweep(repeats),
    ]


if __name__ == "__main__":
    run_program(main)
