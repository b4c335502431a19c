"""`python -m cgm_jax.sweep`: train a grid of runs in one process."""

from collections.abc import Sequence
from dataclasses import dataclass

from cgm_jax.config.fields import SettingError
from cgm_jax.config.grid import build_groups
from cgm_jax.config.shards import cut, parse_shard
from cgm_jax.host.command_line import (
    TrainingOptions,
    chosen_values,
    parse,
    run_program,
    seed_values,
)
from cgm_jax.host.session import train_groups


@dataclass(kw_only=True)
class SweepOptions(TrainingOptions):
    """Train every combination of the given values, side by side in one process.

    An option takes one or more values; several make a grid axis. Options that are not given
    keep the preset's values. The same command again resumes where it was stopped.
    """

    seeds: int | None = None
    """How many seeds: short for --seed 0 1 2 ..."""

    shard: str | None = None
    """I/N: train only the I-th of N parts of the sweep; cgm_jax.merge puts them together."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the program on command-line arguments; return its exit code."""
    options = parse(SweepOptions, arguments, "python -m cgm_jax.sweep")
    preset = options.preset or "quick"
    chosen = seed_values(options, chosen_values(options))
    piece = None if options.shard is None else parse_shard(options.shard)
    if options.resumes(chosen):
        if piece is not None:
            raise SettingError("resume: a sweep resumes as it was begun, without shard")
        return train_groups(options, preset, None)
    groups, shard = build_groups(preset, chosen), None
    if piece is not None:
        groups, shard = cut(groups, *piece)
    return train_groups(options, preset, groups, shard)


if __name__ == "__main__":
    run_program(main)
