"""What is committed of a trained sweep: results/sweeps/NAME/ with its config and learning curves.

Figures and tables are made from these records, so that they can be made again without training.
"""

import dataclasses
import json
import shutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cgm_jax.config.grid import Group
from cgm_jax.config.settings import FIELDS, Settings
from cgm_jax.results.statistics import holds
from cgm_jax.storage.run_directory import CONFIG, RunDirectory
from experiments.learning.setting import Setting, setting_of
from experiments.table import read_table, write_table

SWEEPS = Path(__file__).parents[1] / "results" / "sweeps"
LEARNING = "learning.csv"

Row = dict[str, Any]


def _switch(text: str) -> bool:
    return text == "True"


def _optional(text: str) -> float | None:
    return float(text) if text else None


def _rates(text: str) -> list[float | None]:
    return [None if part == "-" else float(part) for part in text.split()]


COLUMNS: dict[str, Callable[[str], Any]] = {
    **dict.fromkeys(("run", "env"), str),
    **dict.fromkeys(("seed", "epoch", "env_steps", "updates"), int),
    **dict.fromkeys(("her", "cgm"), _switch),
    **dict.fromkeys(("c_g", "kappa", "wall_s", "success_rate"), _optional),
    **dict.fromkeys(("physics_warnings", "failed_epoch", "moved_share"), _optional),
    **dict.fromkeys(("mask_rate_estimated", "mask_rate_training"), _rates),
    **dict.fromkeys(("mask_probability", "mask_share"), _rates),
}
"""What is kept of a metrics row, and how it is read back; per-mask rates have three decimals.

A column that a version of the program did not write is absent from its records.
"""


@dataclass(frozen=True)
class RecordedRun:
    """One run on record.

    Attributes:
        sweep: the sweep that it belongs to.
        settings: all its settings, in today's names.
        rows: its metrics, epoch by epoch.
        alone: whether it trained alone in its process, so that its seconds are its own.
    """

    sweep: str
    settings: Mapping[str, Any]
    rows: Sequence[Row]
    alone: bool

    @property
    def setting(self) -> Setting:
        """What it has in common with other seeds."""
        return setting_of(self.settings)

    @property
    def seed(self) -> int:
        """Its seed."""
        return self.settings["seed"]

    @property
    def budget(self) -> int:
        """Environment steps that it was to train for, had it not been allowed to leave early."""
        return self.settings["epochs"] * (self.rows[0]["env_steps"] // self.rows[0]["epoch"])


def record(trained: RunDirectory, sweep: str) -> None:
    """Keep the config and the rows of all runs that are done."""
    rows = trained.metrics()
    done = {
        run.name
        for group in trained.groups()
        for run in group.runs
        if is_done([row for row in rows if row["run"] == run.name], group.settings)
    }
    kept = [row for row in rows if row["run"] in done]
    if kept:
        columns = [name for name in COLUMNS if any(name in row for row in kept)]
        folder = SWEEPS / sweep
        folder.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(trained.path / CONFIG, folder / CONFIG)
        table = [{name: _text(row.get(name)) for name in columns} for row in kept]
        write_table(folder / LEARNING, table)


def is_done(rows: Sequence[Row], settings: Settings) -> bool:
    """Whether a run got to its last epoch, or holds the success at which it may leave."""
    if not rows:
        return False
    if rows[-1]["epoch"] == settings.epochs:
        return True
    rates = [row["success_rate"] for row in rows]
    return settings.leave_at is not None and holds(rates, settings.leave_at)


def recorded_config(sweep: str) -> Row | None:
    """The config of a sweep on record: what made it, on which machine; None without a record."""
    path = SWEEPS / sweep / CONFIG
    return json.loads(path.read_text()) if path.is_file() else None


def recorded_settings(sweep: str) -> list[tuple[str, Row]]:
    """Name and settings of every run of a sweep of which there is a record, done or not."""
    config = recorded_config(sweep)
    return [
        (run["name"], upgraded({**group["settings"], **run}))
        for group in (config["groups"] if config else [])
        for run in group["runs"]
    ]


def upgraded(settings: Mapping[str, Any]) -> Row:
    """A recorded run's settings in today's names; those that it had not yet are at their defaults.

    A setting that is renamed or replaced is translated here.

    Raises:
        ValueError: a setting that no version had.
    """
    recorded = {name: value for name, value in settings.items() if name != "name"}
    if unknown := recorded.keys() - FIELDS.keys():
        raise ValueError(f"no translation for the recorded settings {', '.join(sorted(unknown))}")
    return {name: plain(recorded.get(name, item.default)) for name, item in FIELDS.items()}


def settings_of(groups: Sequence[Group]) -> list[Row]:
    """All settings of every run of groups, as records hold them."""
    return [
        plain(dataclasses.asdict(group.settings) | dataclasses.asdict(run.hyper))
        for group in groups
        for run in group.runs
    ]


def plain(value: Any) -> Any:
    """A value as JSON gives it back."""
    return json.loads(json.dumps(value))


def recorded_runs(sweep: str) -> list[RecordedRun]:
    """All runs of a sweep that are on record."""
    settings = recorded_settings(sweep)
    if not settings:
        return []
    rows: dict[str, list[Row]] = {name: [] for name, _ in settings}
    for line in read_table(SWEEPS / sweep / LEARNING):
        rows[line["run"]].append({name: COLUMNS[name](text) for name, text in line.items()})
    config = recorded_config(sweep) or {}
    alone = {run["name"] for g in config["groups"] if len(g["runs"]) == 1 for run in g["runs"]}
    return [
        RecordedRun(sweep, values, rows[name], name in alone)
        for name, values in settings
        if rows[name]
    ]


def _text(value: Any) -> Any:
    """A value as a table holds it; rates per mask as one cell, a dash where there is none."""
    if not isinstance(value, list):
        return value
    return " ".join("-" if rate is None else f"{rate:.3g}" for rate in value)
