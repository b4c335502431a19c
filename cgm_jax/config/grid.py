"""From lists of values to runs, and from runs to programs.

Runs that differ only in traced settings share one compiled program. The environment is the
one static axis that a sweep may have: its values run one after another.
"""

import dataclasses
import itertools
import math
import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

from cgm_jax.config.named import absolute, label
from cgm_jax.config.presets import Grid, preset_grid
from cgm_jax.config.settings import Hyperparameters, SettingError, Settings, check_value

TRACED = tuple(item.name for item in dataclasses.fields(Hyperparameters))
CGM_ONLY = ["c_g", "kappa", "factorised"]
HER_ONLY = ["her_k", "her_filter"]
STATIC = tuple(item.name for item in dataclasses.fields(Settings))


GREATEST_NUMBER_OF_RUNS = 100_000

LONGEST_NAME = 200
"""Bytes of a run's name; files may have 255, of which their endings take some."""


@dataclass(frozen=True)
class Run:
    """One training run of a sweep."""

    name: str
    hyper: Hyperparameters


@dataclass(frozen=True)
class Group:
    """Runs that one program trains side by side."""

    settings: Settings
    runs: tuple[Run, ...]


def build_groups(preset: str, options: Grid) -> list[Group]:
    """All runs of a sweep, one group per environment.

    Args:
        preset: a name in `presets.PRESETS`.
        options: lists of values that replace the preset's.

    Raises:
        SettingError: an empty list, several values of a static setting other than `env`, a
            value out of range, the same value twice, or runs that would share a name.
    """
    groups = []
    for env in _values({**preset_grid(preset), **options}, "env", Settings.env):
        grid = {**preset_grid(preset, env), **options, "env": [absolute(env)]}
        for name, values in grid.items():
            _check_axis(name, values)
        settings = Settings(**{name: grid[name][0] for name in STATIC if name in grid})
        groups.append(Group(settings, _runs(grid, env)))
    names = [run.name for group in groups for run in group.runs]
    if len(set(names)) < len(names):
        raise SettingError("env: two environments would give their runs the same names")
    return groups


def split(group: Group, largest: int) -> list[Group]:
    """Cut a group into groups of at most `largest` runs, as equal as can be."""
    count = -(-len(group.runs) // largest)
    size, longer = divmod(len(group.runs), count)
    sizes = [size + 1] * longer + [size] * (count - longer)
    ends = list(itertools.accumulate(sizes))
    return [
        Group(group.settings, group.runs[end - size : end])
        for size, end in zip(sizes, ends, strict=True)
    ]


def _values(grid: Grid, name: str, default: Any) -> Sequence[Any]:
    values = grid.get(name, [default])
    _check_axis(name, values)
    return values


def _check_axis(name: str, values: Sequence[Any]) -> None:
    if not isinstance(values, list | tuple) or not values:
        raise SettingError(f"{name}: needs at least one value")
    if name in STATIC and name != "env" and len(values) > 1:
        raise SettingError(
            f"{name}: is static (it decides the compiled program), so a sweep cannot vary it"
        )
    for value in values:
        check_value(name, value)
    if len(set(values)) < len(values):
        raise SettingError(f"{name}: holds a value twice")


def _runs(grid: Grid, env: str) -> tuple[Run, ...]:
    """The product of the traced axes, less runs that differ only in what has no effect."""
    axes = [grid.get(name, [getattr(Hyperparameters, name)]) for name in TRACED]
    if math.prod(len(axis) for axis in axes) > GREATEST_NUMBER_OF_RUNS:
        longest = max(TRACED, key=lambda name: len(grid.get(name, ())))
        raise SettingError(f"{longest}: more than {GREATEST_NUMBER_OF_RUNS:,} runs in one sweep")
    swept = [name for name in TRACED if len(grid.get(name, ())) > 1]
    runs: dict[Hyperparameters, Run] = {}
    for values in itertools.product(*axes):
        hyper = Hyperparameters(*values)
        runs.setdefault(_effective(hyper), Run(_run_name(env, hyper, swept), hyper))
    return tuple(runs.values())


def _effective(hyper: Hyperparameters) -> Hyperparameters:
    """The same run with everything at its default that has no effect on it."""
    return replace(hyper, **{name: getattr(Hyperparameters, name) for name in _idle(hyper)})


def _idle(hyper: Hyperparameters) -> list[str]:
    """Settings without effect on this run."""
    idle = [] if hyper.her else HER_ONLY
    if not hyper.cgm:
        return idle + CGM_ONLY
    return idle if hyper.kappa else [*idle, "c_g", "factorised"]  # masks drawn uniformly


def _run_name(env: str, hyper: Hyperparameters, swept: Sequence[str]) -> str:
    """A file name that tells runs of a sweep apart: what has no effect stays out of it."""
    parts = [label(env), "her" if hyper.her else "ddpg"]
    parts += [f"cgm-cg{hyper.c_g:.12g}-kappa{hyper.kappa:.12g}"] if hyper.cgm else ["full"]
    for name in swept:
        if name not in ("seed", "c_g", "kappa", "cgm", "her", *_idle(hyper)):
            parts.append(f"{name.replace('_', '')}{getattr(hyper, name):.12g}")
    name = "_".join([*parts, f"seed{hyper.seed}"])
    if len(os.fsencode(name)) > LONGEST_NAME:
        raise SettingError(f"env: a run's file would have too long a name, {name[:60]}...")
    return name
