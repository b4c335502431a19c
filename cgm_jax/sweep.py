"""`python -m cgm_jax.sweep`: train a grid of runs in one process."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

from cgm_jax.host.asked import asked_for
from cgm_jax.host.command_line import parse, run_program
from cgm_jax.host.session import train_groups
from cgm_jax.host.training_options import TrainingOptions
from cgm_jax.machine.commands import begun_with


@dataclass(kw_only=True)
class SweepOptions(TrainingOptions):
    """Train every combination of the given values, in one process.

    A setting takes one or more values; several make a grid axis. Settings that are not given have
    the preset's value, which is shown below (of another preset or task: --preset NAME --env NAME
    --help), or else their default. Where it says "splits programs", each value is a program of its
    own, compiled and trained one after another; values of the others share a program, and train
    side by side on a GPU, one per core on a CPU. The same command with the same --out resumes where
    it was stopped.
    """

    default_preset: ClassVar[str] = "quick"
    sweeps: ClassVar[bool] = True

    seeds: int | None = None
    """How many seeds: short for --seed 0 1 2 ..."""

    shard: str | None = None
    """I/N: train only the I-th of N parts of the sweep; cgm_jax.merge puts them together."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the program on command-line arguments; return its exit code.

    Raises:
        SettingError: input is refused.
        InUseError: another process works in the directory.
        SystemExit: an argument is no option, or asks for help.
    """
    options = parse(SweepOptions, arguments, "python -m cgm_jax.sweep")
    command = begun_with("cgm_jax.sweep", arguments)
    return train_groups(options, asked_for(options), command)


if __name__ == "__main__":
    run_program(main)
