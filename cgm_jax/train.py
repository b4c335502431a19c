"""`python -m cgm_jax.train`: train one run, which is a sweep of one."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

from cgm_jax.config.fields import SettingError
from cgm_jax.config.grid import build_groups
from cgm_jax.host.command_line import TrainingOptions, chosen_values, parse, run_program
from cgm_jax.host.session import train_groups


@dataclass(kw_only=True)
class TrainOptions(TrainingOptions):
    """Train one run.

    Settings that are not given have the first of the preset's values, which is shown below (of
    another: --preset NAME --help), or else their default. "Splits programs" is for sweeps. The same
    command again resumes where it was stopped.
    """

    default_preset: ClassVar[str] = "cpu"
    sweeps: ClassVar[bool] = False


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the program on command-line arguments; return its exit code."""
    options = parse(TrainOptions, arguments, "python -m cgm_jax.train")
    chosen = chosen_values(options)
    for name, values in chosen.items():
        if len(values) > 1:
            raise SettingError(f"{name}: takes one value here; cgm_jax.sweep takes several")
    preset = options.preset or options.default_preset
    if options.resumes(chosen):
        return train_groups(options, preset, None)
    return train_groups(options, preset, build_groups(preset, chosen, single=True))


if __name__ == "__main__":
    run_program(main)
