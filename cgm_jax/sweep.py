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
from cgm_jax.settings import SettingError
from cgm_jax.startup import prepare_jax

STOPPED = 130
"""Exit code after Ctrl-C, as shells have it."""


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
    if options.out == Path():
        raise SettingError("out: is empty")
    prepare_jax()
    import jax

    from cgm_jax.figures import draw_figures
    from cgm_jax.progress import SweepProgress, physics_lines, summary_lines
    from cgm_jax.runner import plan_jobs, run_job

    jobs, notes = plan_jobs(groups)
    directory = RunDirectory.create(out)
    device = f"{len(jax.devices())} x {jax.devices()[0].device_kind}"
    directory.write_config([job.group for job in jobs], options.preset, device)
    print(f"{out}: {'; '.join(notes)}", file=sys.stderr)
    started, success = time.monotonic(), {}
    cycles = sum(job.group.settings.epochs * job.group.settings.cycles_per_epoch for job in jobs)
    try:
        with SweepProgress(cycles) as progress:
            for index, job in enumerate(jobs):
                success |= run_job(job, index, directory, progress)
    except KeyboardInterrupt:
        print(f"stopped; what was done so far is in {out}", file=sys.stderr)
        return STOPPED
    draw_figures(directory)
    lines = summary_lines(list(success.items())) + physics_lines(directory.metrics())
    print("\n".join(lines))
    print(f"{time.monotonic() - started:.0f} s; figures in {out / 'figures'}")
    return 0


if __name__ == "__main__":
    run_program(main)
