"""What is to be trained: plans.toml, as options of `cgm_jax.sweep`."""

import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from cgm_jax.config.grid import build_groups
from cgm_jax.config.settings import FIELDS
from cgm_jax.host.command_line import chosen_values, parse, seed_values
from cgm_jax.sweep import SweepOptions
from experiments.learning.records import RecordedRun, recorded_runs, settings_of

PLANS = Path(__file__).parents[1] / "plans.toml"
PRESET = "cpu"
"""Any would do: a plan's settings replace all of a preset's."""

Settings = Mapping[str, Any]


class Question(NamedTuple):
    """A question of the report: the sweeps that answer it, and the figures that show it."""

    sweeps: Sequence[str]
    figures: Sequence[str]


class Plans(NamedTuple):
    """Settings of every sweep, written out, and what every question rests on."""

    sweeps: Mapping[str, Settings]
    questions: Mapping[str, Question]


def read_plans(path: Path = PLANS) -> Plans:
    """Read plans.toml, in which settings and sweeps may build on other settings (`like`)."""
    plans = tomllib.loads(path.read_text())

    def resolved(entry: Settings) -> dict[str, Any]:
        own = dict(entry)
        like = own.pop("like", None)
        return {**resolved(plans["settings"][like]), **own} if like else own

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


def planned_settings(settings: Settings, preset: str = PRESET) -> list[dict[str, Any]]:
    """All settings of each run of a planned sweep."""
    program = "python -m cgm_jax.sweep"
    parsed = parse(SweepOptions, options_of(settings, preset), program)
    return settings_of(build_groups(preset, seed_values(parsed, chosen_values(parsed))))


def not_written_out(settings: Settings) -> set[str]:
    """Settings with a value by default that a plan leaves to presets and defaults."""
    seeds = {"seed"} if "seeds" in settings else set()
    return {
        name for name, item in FIELDS.items() if item.default is not None and name not in settings
    } - seeds


def _text(value: Any) -> str:
    if isinstance(value, bool):
        return "on" if value else "off"
    return str(value)
