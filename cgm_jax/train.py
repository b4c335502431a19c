"""`python -m cgm_jax.train`: train one run, which is a sweep of one."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

from cgm_jax.host.asked import asked_for
from cgm_jax.host.command_line import parse, run_program
from cgm_jax.host.session import train_groups
from cgm_jax.host.training_options import TrainingOptions
from cgm_jax.machine.commands import begun_with


@dataclass(kw_only=True)
class TrainOptions(TrainingOptions):
    """Train one run.

    Settings that are not given have the first of the preset's values, which is shown below (of
    another preset or task: --preset NAME --env NAME --help), or else their default. "Splits
    programs" is for sweeps. The same command with the same --out resumes where it was stopped.
    """

    default_preset: ClassVar[str] = "cpu"
    sweeps: ClassVar[bool] = False


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the program on command-line arguments; return its exit code.

    Raises:
        SettingError: input is refused.
        InUseError: another process works in the directory.
        SystemExit: an argument is no option, or asks for help.
    """
    options = parse(TrainOptions, arguments, "python -m cgm_jax.train")
    command = begun_with("cgm_jax.train", arguments)
    return train_groups(options, asked_for(options), command)


if __name__ == "__main__":
    run_program(main)
