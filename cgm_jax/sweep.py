"""`python -m cgm_jax.sweep`: train a grid of runs in one process."""

import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

from cgm_jax.command_line import (
    Preset,
    SettingOptions,
    chosen_values,
    parse,
    run_program,
    seed_values,
)
from cgm_jax.grid import Group, build_groups
from cgm_jax.run_directory import RunDirectory
from cgm_jax.startup import prepare_jax


@dataclass(kw_only=True)
class SweepOptions(SettingOptions):
    """Train every combination of the given values, side by side in one process.

    An option takes one or more values; several make a grid axis. Options that are not given
    keep the preset's values.
    """

    preset: Preset = "quick"
    """Values to start from."""

    out: Path | None = None
    """Directory for the results (default: runs/PRESET-TIME)."""

    seeds: int | None = None
    """How many seeds: short for --seed 0 1 2 ..."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the program on command-line arguments; return its exit code."""
    options = parse(SweepOptions, arguments, "python -m cgm_jax.sweep")
    groups = build_groups(options.preset, seed_values(options, chosen_values(options)))
    return train_groups(groups, options)


def train_groups(groups: list[Group], options: Any) -> int:
    """Train groups of runs one after another into `options.out`; return the exit code."""
    out = options.out or Path("runs") / f"{options.preset}-{datetime.now():%Y%m%d-%H%M%S}"
    # Everything above needed no JAX; the environments do, to be checked before anything compiles.
    prepare_jax()
    from cgm_jax.figures import draw_figures
    from cgm_jax.progress import SweepProgress, summary_lines
    from cgm_jax.runner import fit_into_memory, run_group

    groups, notes = fit_into_memory(groups)
    directory = RunDirectory.create(out)
    directory.write_config(groups, options.preset)
    print(f"{out}: {'; '.join(notes)}", file=sys.stderr)
    started, success = time.monotonic(), {}
    cycles = sum(group.settings.epochs * group.settings.cycles_per_epoch for group in groups)
    with SweepProgress(cycles) as progress:
        for index, group in enumerate(groups):
            success |= run_group(group, index, directory, progress)
    draw_figures(directory)
    print("\n".join(summary_lines(list(success.items()))))
    print(f"{time.monotonic() - started:.0f} s; figures in {out / 'figures'}")
    return 0


if __name__ == "__main__":
    run_program(main)
