"""`python -m cgm_jax.train`: train one run, which is a sweep of one."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from cgm_jax.command_line import Preset, SettingOptions, chosen_values, parse, run_program
from cgm_jax.grid import build_groups
from cgm_jax.presets import preset_grid
from cgm_jax.settings import SettingError
from cgm_jax.sweep import train_groups


@dataclass(kw_only=True)
class TrainOptions(SettingOptions):
    """Train one run. Options that are not given keep the first of the preset's values."""

    preset: Preset = "cpu"
    """Values to start from."""

    out: Path | None = None
    """Directory for the results (default: runs/PRESET-TIME)."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the program on command-line arguments; return its exit code."""
    options = parse(TrainOptions, arguments, "python -m cgm_jax.train")
    chosen = chosen_values(options)
    for name, values in chosen.items():
        if len(values) > 1:
            raise SettingError(f"{name}: takes one value here; cgm_jax.sweep takes several")
    grid = preset_grid(options.preset)
    first = {name: values[:1] for name, values in grid.items() if len(values) > 1}
    return train_groups(build_groups(options.preset, {**first, **chosen}), options)


if __name__ == "__main__":
    run_program(main)
