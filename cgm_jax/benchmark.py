"""`python -m cgm_jax.benchmark`: how far the trainer is from what the machine can do.

With `--against COMMIT`: how much faster or slower it is than at another commit.

It is the CPU that is measured, also where there is a GPU, but for `--part device` and `--against`.
What has a target is a ratio of two measurements, taken in turn, so that a slow or busy machine
changes both, or the seconds of a start; rates stand beside the ratios. Nothing else should run
meanwhile.
"""

import shlex
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Literal

import tyro
from rich.console import Console
from rich.table import Table

from cgm_jax.config.fields import SettingError
from cgm_jax.host.command_line import parse, refuse, run_program
from cgm_jax.host.exit_codes import ExitCode
from cgm_jax.host.startup import prepare_jax
from cgm_jax.measuring.child import MeasurementError
from cgm_jax.measuring.figures import Figure
from cgm_jax.measuring.start import first_step, measure_starts
from cgm_jax.measuring.workload import choose_cpu
from cgm_jax.storage.provenance import cores

DEFAULT_SWEEP = ("--preset", "cpu", "--env", "push")
Text = Annotated[str | None, tyro.conf.arg(metavar="STR", help_behavior_hint="")]


@dataclass(kw_only=True)
class BenchmarkOptions:
    """Measure rollouts, updates and sweeps, as ratios, and the start, in seconds."""

    part: Literal["all", "first-step", "device"] = "all"
    """first-step: only start, take one training step, and exit. device: only print the device, the
    engine that is the default there, and its rate."""

    repeats: int = 5
    """Measurements per figure, of which the median counts. With --against: pairs of processes."""

    against: Text = None
    """Compare this checkout with another commit instead, by sweeps of both that run in turn."""

    against_options: Text = None
    """With --against: options for the other commit where it needs others than this one, such as
    --against-options="--preset cpu"."""

    timed_epochs: int = 6
    """With --against: epochs timed in each process after its first."""

    sweep: Annotated[
        tyro.conf.Positional[tuple[str, ...]],
        tyro.conf.arg(metavar="[-- OPTION ...]", help_behavior_hint=""),
    ] = ()
    """With --against: options of cgm_jax.sweep (default: --preset cpu --env push)."""

    def check(self) -> None:
        """Check every option that needs nothing but itself.

        Raises:
            SettingError: an option out of its range, or that needs --against.
        """
        least = 1 if self.against is None else 2  # an interval needs two
        for name, low in (("repeats", least), ("timed_epochs", 1)):
            if not low <= getattr(self, name) <= 1000:
                raise SettingError(f"{name}: {getattr(self, name)} is not within [{low}, 1000]")
        if self.against is None:
            for name in ("against_options", "sweep"):
                if getattr(self, name):
                    raise SettingError(f"{name}: is for --against")
        elif self.part != "all":
            raise SettingError("part: not with --against")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the program on command-line arguments; return its exit code.

    Raises:
        SettingError: input is refused.
        SystemExit: an argument is no option, or asks for help.
    """
    options = parse(BenchmarkOptions, arguments, "python -m cgm_jax.benchmark")
    options.check()
    if options.against is not None:
        return _compare(options, options.against)
    if options.part == "first-step":
        prepare_jax()
        first_step()
        return ExitCode.DONE
    if options.part == "device":
        prepare_jax()
        from cgm_jax.measuring.engines import device_line

        print(device_line(options.repeats))
        return ExitCode.DONE
    choose_cpu()
    try:
        figures = _measure(options.repeats)
    except MeasurementError as error:
        refuse(str(error), ExitCode.FAILED)
    table = Table("measured", "value", "target", title=cores())
    for figure in figures:
        table.add_row(*figure.row())
    Console().print(table)
    return ExitCode.DONE


def _compare(options: BenchmarkOptions, against: str) -> int:
    from cgm_jax.measuring.comparison import check_options, compare, parse_options

    here = there = check_options("sweep", options.sweep or DEFAULT_SWEEP)
    if options.against_options is not None:
        there = parse_options("against_options", options.against_options)
    try:
        sides, comparisons = compare(against, here, there, options.repeats, options.timed_epochs)
    except MeasurementError as error:
        refuse(str(error), ExitCode.FAILED)
    this, other = (side.checkout.commit for side in sides)
    table = Table(
        *("measured", this, other, "ratio", "95 % interval", "at most"),
        title=f"{shlex.join(here)}, {cores()}",
        caption="training: per run and 1,000 environment steps, evaluations included; "
        "start: with an empty compilation cache",
    )
    for comparison in comparisons:
        table.add_row(*comparison.row())
    Console().print(table)
    return ExitCode.DONE


def _measure(repeats: int) -> list[Figure]:
    # Before anything else runs: a process of its own each.
    starts = measure_starts(repeats)
    from cgm_jax.measuring.rollouts import measure_rollouts
    from cgm_jax.measuring.sweeps import measure_sweep
    from cgm_jax.measuring.updates import measure_updates

    # A sweep comes first, since it has JAX make as many devices as there are cores.
    sweep = measure_sweep(repeats)
    prepare_jax()
    return [*starts, *measure_rollouts(repeats), *measure_updates(repeats), *sweep]


if __name__ == "__main__":
    run_program(main)
