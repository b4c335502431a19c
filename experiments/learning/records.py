"""What is committed of a trained sweep: results/sweeps/NAME/ with its config and learning curves.

Figures and tables are drawn from these records, so that they can be drawn again without training.
"""

import csv
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

from cgm_jax.grid import Group, Run
from cgm_jax.host.run_directory import CONFIG, RunDirectory
from cgm_jax.settings import Settings
from cgm_jax.statistics import holds
from experiments.learning.tables import Row, write_table

SWEEPS = Path(__file__).parents[1] / "results" / "sweeps"
LEARNING = "learning.csv"


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
    **dict.fromkeys(("c_g", "kappa", "wall_s"), float),
    **dict.fromkeys(("success_rate", "physics_warnings", "failed_epoch"), _optional),
    **dict.fromkeys(("mask_rate_estimated", "mask_rate_training", "mask_probability"), _rates),
}
"""What is kept of a metrics row, and how it is read back; per-mask rates have three decimals."""


def record(trained: RunDirectory, sweep: str) -> None:
    """Keep the config and the rows of all runs that are done."""
    rows = trained.metrics()
    done = {
        run.name
        for group in trained.groups()
        for run in group.runs
        if is_done([row for row in rows if row["run"] == run.name], group.settings)
    }
    table = [{name: _text(row[name]) for name in COLUMNS} for row in rows if row["run"] in done]
    if table:
        folder = SWEEPS / sweep
        folder.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(trained.path / CONFIG, folder / CONFIG)
        write_table(folder / LEARNING, table)


def recorded_groups(sweep: str) -> list[Group]:
    """The groups of runs of a sweep of which there is a record, done or not; else none."""
    folder = RunDirectory(SWEEPS / sweep)
    return folder.groups() if folder.holds_sweep() else []


def recorded_rows(sweep: str) -> list[Row]:
    """Rows of all runs on record, with what a comparison needs from the config besides."""
    groups = recorded_groups(sweep)
    if not groups:
        return []
    facts = {run.name: _facts(group, run) for group in groups for run in group.runs}
    with (SWEEPS / sweep / LEARNING).open(newline="") as file:
        rows = [
            {name: read(line[name]) for name, read in COLUMNS.items()}
            for line in csv.DictReader(file)
        ]
    return [{"sweep": sweep, **facts[row["run"]], **row} for row in rows]


def is_done(rows: list[Row], settings: Settings) -> bool:
    """Whether a run got to its last epoch, or holds the success at which it may leave."""
    if not rows:
        return False
    if rows[-1]["epoch"] == settings.epochs:
        return True
    rates = [row["success_rate"] for row in rows]
    return settings.leave_at is not None and holds(rates, settings.leave_at)


def _facts(group: Group, run: Run) -> Row:
    estimate = "product" if run.hyper.factorised else "joint"
    return {
        "her_filter": run.hyper.her_filter,
        "estimate": "measured" if group.settings.masked_evaluation_episodes else estimate,
        "alone": len(group.runs) == 1,
        "leave_at": group.settings.leave_at,
    }


def _text(value: Any) -> Any:
    """A value as a table holds it; rates per mask as one cell, a dash where there is none."""
    if not isinstance(value, list):
        return value
    return " ".join("-" if rate is None else f"{rate:.3g}" for rate in value)
