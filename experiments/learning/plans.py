"""What is to be trained: plans.toml, as options of `cgm_jax.sweep`."""

import functools
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from cgm_jax.config.components import ROOMS, component
from cgm_jax.config.fields import declared
from cgm_jax.config.grid import build_groups
from cgm_jax.config.presets import Grid
from cgm_jax.config.settings import LOOP_FIELDS
from cgm_jax.host.command_line import parse
from cgm_jax.host.training_options import chosen_values, seed_values
from cgm_jax.sweep import SweepOptions
from experiments.learning.records import RecordedRun, recorded_runs, settings_of

PLANS = Path(__file__).parents[1] / "plans.toml"
PRESET = "cpu"
"""Any would do: a plan's settings replace all of a preset's."""

Settings = Mapping[str, Any]


class Question(NamedTuple):
    """A question of the report: the sweeps that answer it, and the figures that show it.

    Attributes:
        text: the question in words.
        sweeps: names of sweeps.
        figures: names of figures.
    """

    text: str
    sweeps: Sequence[str]
    figures: Sequence[str]


class Plans(NamedTuple):
    """Settings of every sweep, written out, and what every question rests on."""

    sweeps: Mapping[str, Settings]
    questions: Mapping[str, Question]


def read_plans(path: Path = PLANS) -> Plans:
    """Read plans.toml, in which settings and sweeps may build on other settings (`like`).

    Who asks again gets the same, not to be changed.
    """
    return _parsed(path.read_text())


@functools.lru_cache(maxsize=2)  # the report asks hundreds of times
def _parsed(text: str) -> Plans:
    plans = tomllib.loads(text)

    def resolved(entry: Settings) -> dict[str, Any]:
        own = dict(entry)
        like = own.pop("like", [])
        inherited: dict[str, Any] = {}
        for name in [like] if isinstance(like, str) else like:
            inherited |= resolved(plans["settings"][name])
        return inherited | own

    return Plans(
        {name: resolved(entry) for name, entry in plans["sweeps"].items()},
        {name: Question(**entry) for name, entry in plans["questions"].items()},
    )


def runs_of(question: str) -> list[RecordedRun]:
    """All runs on record of a question."""
    sweeps = read_plans().questions[question].sweeps
    return [run for sweep in sweeps for run in recorded_runs(sweep)]


def options_of(settings: Settings, preset: str = PRESET) -> list[str]:
    """Options of `cgm_jax.sweep` that ask for these settings."""
    options = ["--preset", preset]
    for name, value in settings.items():
        values = value if isinstance(value, list) else [value]
        options += [f"--{name.replace('_', '-')}", *map(_text, values)]
    return options


def planned_settings(settings: Settings) -> list[dict[str, Any]]:
    """Settings that have an effect on each run of a planned sweep."""
    return settings_of_grid(grid_of(settings))


def grid_of(settings: Settings) -> Grid:
    """The values that a planned sweep asks for, as `cgm_jax.sweep` understands its options."""
    parsed = parse(SweepOptions, options_of(settings), "python -m cgm_jax.sweep")
    return seed_values(parsed, chosen_values(parsed))


def settings_of_grid(grid: Grid, preset: str = PRESET) -> list[dict[str, Any]]:
    """Settings that have an effect on each run of a grid."""
    groups = build_groups(preset, grid)
    return [settings_of(run) for group in groups for run in group.runs]


def not_written_out(settings: Settings) -> set[str]:
    """Settings with a value by default that a plan leaves to presets and defaults."""
    fields = dict(LOOP_FIELDS)
    for kind in ROOMS:
        chosen = settings.get(kind, [])
        for name in [chosen] if isinstance(chosen, str) else chosen:
            fields |= {item.name: item for item in declared(component(kind, name))}
    by_default = {name for name, item in fields.items() if item.default is not None}
    seeds = {"seed"} if "seeds" in settings else set()
    return (by_default | set(ROOMS)) - set(settings) - seeds


def _text(value: Any) -> str:
    if isinstance(value, bool):
        return "on" if value else "off"
    return str(value)
