"""What is committed of a trained sweep: results/sweeps/NAME/ with its config and learning curves.

Figures and tables are made from these records, so that they can be made again without training.
"""

import functools
import json
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cgm_jax.config.grid import Run, idle_settings, run_of
from cgm_jax.config.named import is_own
from cgm_jax.results.statistics import holds
from cgm_jax.storage.formats import upgraded
from cgm_jax.storage.layout import CONFIG, METRICS
from cgm_jax.storage.metrics import to_lines
from cgm_jax.storage.run_directory import RunDirectory
from experiments.learning.setting import Setting, setting_of
from experiments.table import read_table, write_table

SWEEPS = Path(__file__).parents[1] / "results" / "sweeps"
LEARNING = "learning.csv"

Row = dict[str, Any]

FOLDERS_ABOVE = re.compile(r'(?<=")/[^"]*/(?=experiments/[^"]*\.py[:"])')
"""Where the checkout lay, in names of an environment of its own and of its file."""

FOLDERS_OF_RUNS = re.compile(r'("--out",\s*")/(?:[^"]*/)?([^"/]+")')
"""Where runs lay, in the command that began them; the directory's own name stays."""


def _switch(text: str) -> bool:
    return text == "True"


def _optional(text: str) -> float | None:
    return float(text) if text else None


def _rates(text: str) -> list[float | None]:
    return [None if part == "-" else float(part) for part in text.split()]


COLUMNS: dict[str, Callable[[str], Any]] = {
    **dict.fromkeys(("run", "env", "curriculum", "agent"), str),
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
        name: its own name.
        settings: all settings that have an effect on it, in today's names.
        rows: its metrics, epoch by epoch.
        alone: whether it trained alone in its process, so that its seconds are its own.
    """

    sweep: str
    name: str
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


def record(trained: RunDirectory, sweep: str, planned: Sequence[Row]) -> None:
    """Keep the config and the rows of all runs that are done; where none is, the record of before.

    Args:
        trained: where they were trained.
        sweep: the name of the record.
        planned: settings of the runs that it is to hold; see `settings_of`.

    Raises:
        ValueError: other runs were trained than are planned, or one is not done that is planned and
            on record; nothing is written then.
    """
    settings, done = trained_settings(trained), done_runs(trained)
    if not same_runs([values for _, values in settings], planned):
        raise ValueError(f"{trained.path}: these are other runs than are planned for {sweep}")
    missing = [_however_long(values) for name, values in settings if name not in done]
    for run in recorded_runs(sweep) if done else ():
        if _however_long(run.settings) in missing:
            raise ValueError(
                f"{trained.path}: {run.name} is on record and not done here; nothing was recorded"
            )
    if done:
        rows = [row for row in trained.metrics() if row["run"] in done]
        kept = json.loads(FOLDERS_ABOVE.sub("", json.dumps(rows)))
        config = trained.path / CONFIG
        columns = [name for name in COLUMNS if any(name in row for row in kept)]
        folder = SWEEPS / sweep
        folder.mkdir(parents=True, exist_ok=True)
        text = FOLDERS_ABOVE.sub("", config.read_text())
        (folder / CONFIG).write_text(FOLDERS_OF_RUNS.sub(r"\1runs/\2", text))
        table = [{name: _text(row.get(name)) for name in columns} for row in kept]
        write_table(folder / LEARNING, table)


def trained_settings(trained: RunDirectory) -> list[tuple[str, Row]]:
    """Name and settings of every run of a directory; see `settings_from`."""
    return settings_by_run(_read(trained.path / CONFIG))


def done_runs(trained: RunDirectory) -> set[str]:
    """Names of the runs of a directory that are done."""
    rows = trained.metrics() if (trained.path / METRICS).is_file() else []
    return {
        name
        for name, values in trained_settings(trained)
        if is_done([row for row in rows if row["run"] == name], values)
    }


def restore(sweep: str, folder: Path) -> None:
    """Make a run directory from a record: its config, and its metrics as far as they were kept."""
    rows = [row for run in recorded_runs(sweep) for row in run.rows]
    folder.mkdir(parents=True)
    (folder / CONFIG).write_bytes((SWEEPS / sweep / CONFIG).read_bytes())
    (folder / METRICS).write_text(to_lines(sorted(rows, key=lambda row: row["epoch"])))


def is_done(rows: Sequence[Row], settings: Mapping[str, Any]) -> bool:
    """Whether a run got to its last epoch, or holds the success at which it may leave."""
    if not rows:
        return False
    if rows[-1]["epoch"] == settings["epochs"]:
        return True
    rates = [row["success_rate"] for row in rows]
    return settings["leave_at"] is not None and holds(rates, settings["leave_at"])


def recorded_config(sweep: str) -> Row | None:
    """The config of a sweep on record: what made it, on which machine; None without a record."""
    path = SWEEPS / sweep / CONFIG
    return _read(path) if path.is_file() else None


def _read(path: Path) -> Row:
    return upgraded(json.loads(path.read_text()))


def recorded_settings(sweep: str) -> list[tuple[str, Row]]:
    """Name and settings of every run of a sweep of which there is a record, done or not."""
    config = recorded_config(sweep)
    return settings_by_run(config) if config else []


def settings_by_run(config: Mapping[str, Any]) -> list[tuple[str, Row]]:
    """Name and settings of every run of a config; see `settings_from`."""
    return [
        (run["name"], settings_from(_of_record(run)))
        for group in config["groups"]
        for run in group["runs"]
    ]


def _of_record(run: Mapping[str, Any]) -> Row:
    """A run's settings; "auto", as plans once named the engine, was `native` wherever they ran.

    An environment of one's own has no engine to name.
    """
    values = {"engine": "auto", **run}
    del values["name"]
    was_native = values["engine"] == "auto" and not is_own(values["env"])
    return {**values, "engine": "native"} if was_native else values


def settings_from(values: Mapping[str, Any]) -> Row:
    """A run's settings from values by name; those that it does not have are at their defaults.

    Raises:
        SettingError: a value of no setting, or out of its range.
    """
    widths = {"hidden_layers": tuple(values["hidden_layers"])} if "hidden_layers" in values else {}
    return settings_of(run_of("", {**values, **widths})[1])


def settings_of(run: Run) -> Row:
    """Settings that have an effect on a run, as JSON gives them back and any checkout has them."""
    idle = idle_settings(run.hyper)
    values = {name: value for name, value in run.values.items() if name not in idle}
    return json.loads(FOLDERS_ABOVE.sub("", json.dumps(values)))


def same_runs(one: Sequence[Row], other: Sequence[Row]) -> bool:
    """Whether two sweeps hold the same runs, whatever their order and names."""
    return _in_order(one) == _in_order(other)


def _however_long(settings: Mapping[str, Any]) -> Row:
    """Settings less those that say for how long a run trains."""
    return {name: value for name, value in settings.items() if name not in ("epochs", "leave_at")}


def _in_order(settings: Sequence[Mapping[str, Any]]) -> list[str]:
    return sorted(json.dumps(values, sort_keys=True) for values in settings)


def together(group: dict[str, Any]) -> int:
    """How many runs trained side by side with those of a group, themselves included."""
    return group.get("together", len(group["runs"]))


def is_whole(sweep: str) -> bool:
    """Whether all runs of a sweep are on record."""
    settings = recorded_settings(sweep)
    return bool(settings) and len(recorded_runs(sweep)) == len(settings)


def recorded_runs(sweep: str) -> list[RecordedRun]:
    """All runs of a sweep that are on record; who asks again gets the same, not to be changed."""
    folder = SWEEPS / sweep
    return [*_runs_of(folder, _version(folder / CONFIG), _version(folder / LEARNING))]


def _version(path: Path) -> tuple[int, ...] | None:
    """What is another once a file has other content; None where there is no file."""
    if not path.is_file():
        return None
    status = path.stat()
    return status.st_mtime_ns, status.st_size, status.st_ino


@functools.lru_cache(maxsize=256)  # the report asks for a sweep's runs up to a hundred times
def _runs_of(folder: Path, *_: tuple[int, ...] | None) -> Sequence[RecordedRun]:
    """What `recorded_runs` returns of a folder whose files are of these versions."""
    sweep = folder.name
    settings = recorded_settings(sweep)
    if not settings:
        return ()
    rows: dict[str, list[Row]] = {name: [] for name, _ in settings}
    facts = {name: _facts(values) for name, values in settings}
    for line in read_table(SWEEPS / sweep / LEARNING):
        row = {name: COLUMNS[name](text) for name, text in line.items()}
        rows[line["run"]].append(row | facts[line["run"]])
    config = recorded_config(sweep) or {}
    alone = {run["name"] for g in config["groups"] if together(g) == 1 for run in g["runs"]}
    return [
        RecordedRun(sweep, name, values, rows[name], name in alone)
        for name, values in settings
        if rows[name]
    ]


def _facts(settings: Mapping[str, Any]) -> Row:
    """What a row of metrics.jsonl says of its run, as the program writes it today."""
    named = ("env", "seed", "curriculum", "agent", "c_g", "kappa", "her")
    return {
        **{name: settings.get(name) for name in named},
        "cgm": settings["curriculum"] == "cgm",
    }


def _text(value: Any) -> Any:
    """A value as a table holds it; rates per mask as one cell, a dash where there is none."""
    if not isinstance(value, list):
        return value
    return " ".join("-" if rate is None else f"{rate:.3g}" for rate in value)
