"""Sweeps as the page shows them, read from run directories that may come from anywhere."""

import itertools
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, TypeGuard

from cgm_jax.config.fields import SettingError
from cgm_jax.results.figures.runs import TrainedRun, grouped, runs_of
from cgm_jax.results.statistics import holds
from cgm_jax.storage.checkpoints import epochs_done, last_whole, position_of
from cgm_jax.storage.layout import METRICS
from cgm_jax.storage.metrics import Row, check_row, plain_row
from cgm_jax.storage.run_directory import RunDirectory
from cgm_jax.storage.untrusted import UNREADABLE

Values = Mapping[str, Any]

ENTRIES: Values = {
    "run": str,
    "env": str,
    "seed": int,
    "epoch": int,
    "env_steps": int | float,
    "success_rate": int | float | None,
}
"""What the page reads of a row in any case, and of what types."""


@dataclass(frozen=True)
class Sweep:
    """One run directory.

    Attributes:
        path: the directory.
        config: its config.json, in the present format.
        runs: those with at least one epoch.
        told: settings that rows tell apart; None if they are of a version that did not say.
        lacks_rows: whether a checkpoint holds epochs that metrics.jsonl does not.
    """

    path: Path
    config: Values
    runs: Sequence[TrainedRun]
    told: Sequence[str] | None
    lacks_rows: bool

    @cached_property
    def planned(self) -> dict[str, Values]:
        """The settings of every run that it was to train, by the run's name."""
        return {run["name"]: run for group in self.config["groups"] for run in group["runs"]}

    @property
    def finished(self) -> bool:
        """Whether all of its runs are done."""
        by_name = {run.name: run for run in self.runs}
        return all(
            _is_done([by_name.get(values["name"]) for values in group["runs"]], group["runs"])
            for group in self.config["groups"]
        )


def read_sweep(path: Path) -> Sweep:
    """Read a run directory; runs no code of it.

    Raises:
        SettingError: it holds no sweep, or a part of it is damaged or leads elsewhere.
    """
    directory = RunDirectory.open(path)
    config = plain_row(directory.config.read())
    done = _epochs_done(path)  # before the rows, which are written before a checkpoint
    rows = _rows(directory)
    try:
        runs = runs_of(rows)
        sweep = Sweep(path, config, runs, _told(rows), _lacks_rows(path, config, runs, done))
        _check_runs(sweep)
    except UNREADABLE as error:
        raise _damaged(path, error) from None
    return sweep


def _epochs_done(path: Path) -> dict[int, int]:
    """Whole epochs in the checkpoints of each group; none where they cannot be read just now."""
    try:
        return epochs_done(path / "checkpoints")
    except OSError:
        return {}


def _lacks_rows(
    path: Path, config: Values, runs: Sequence[TrainedRun], done: Mapping[int, int]
) -> bool:
    """Whether a group's last checkpoint has epochs of which there are no rows.

    Args:
        path: of the run directory.
        config: its config.
        runs: with their rows.
        done: epochs in checkpoints by group, of which those that count here must be whole.
    """
    written = {run.name: [row["epoch"] for row in run.rows] for run in runs}
    for number, epochs in done.items():
        there = [
            sum(epoch <= epochs for epoch in written.get(values["name"], ()))
            for group in config["groups"][number : number + 1]
            for values in group["runs"]
        ]
        least = min(there, default=epochs)
        if least < epochs and least < _whole_epochs(path, number):
            return True
    return False


def _whole_epochs(path: Path, group: int) -> int:
    """Epochs in a group's last whole checkpoint, from which its rows come back."""
    try:
        whole, _ = last_whole(path / "checkpoints", group)
    except (OSError, SettingError):  # cannot be read just now, or by this version
        return 0
    return position_of(whole)[0] if whole else 0


def _rows(directory: RunDirectory) -> list[Row]:
    """All rows.

    Raises:
        SettingError: they cannot be read, or are not such as a sweep writes.
    """
    try:
        rows = directory.metrics()
        for row in rows:
            _check_row(row)
            if not is_finite(row["success_rate"]):
                row["success_rate"] = None
    except FileNotFoundError:
        return []
    except (OSError, *UNREADABLE) as error:
        raise _damaged(directory.path, error) from None
    return rows


def _check_row(row: Row) -> None:
    check_row(row, ENTRIES)
    rate = row["success_rate"]
    if is_finite(rate) and not 0 <= rate <= 1:
        raise ValueError(f"success_rate: {rate!r:.40} in a row")
    if not is_finite(row["env_steps"]):
        raise ValueError(f"env_steps: {row['env_steps']} in a row")


def is_finite(value: Any) -> TypeGuard[float]:
    """Whether a value is a number with a place on an axis."""
    number = isinstance(value, int | float) and not isinstance(value, bool)
    return number and abs(value) <= sys.float_info.max  # which NaN is not, nor an int beyond it


def _check_runs(sweep: Sweep) -> None:
    for values in sweep.planned.values():
        if not isinstance(values["epochs"], int):
            raise ValueError(f"epochs: {values['epochs']!r:.40}")
    for run in sweep.runs:
        epochs = [row["epoch"] for row in run.rows]
        if any(later <= earlier for earlier, later in itertools.pairwise(epochs)):
            raise ValueError(f"epochs of {run.name:.40} are not in order")
    if not is_finite(sum(run.last_steps for run in sweep.runs)):
        raise ValueError("env_steps: too many in all")


def _told(rows: Sequence[Row]) -> list[str] | None:
    if any("swept" not in row for row in rows):
        return None
    return list(dict.fromkeys(name for row in rows for name in row["swept"]))


def _is_done(runs: Sequence[TrainedRun | None], settings: Sequence[Values]) -> bool:
    """Whether runs that train together are: at their last epoch, or all hold what they leave at."""
    there = [run for run in runs if run is not None]
    if len(there) < len(runs):
        return False
    pairs = list(zip(there, settings, strict=True))
    if all(run.rows[-1]["epoch"] >= values["epochs"] for run, values in pairs):
        return True
    return all(
        isinstance(level := values.get("leave_at"), int | float)
        and holds([row["success_rate"] for row in run.rows], level)
        for run, values in pairs
    )


def _damaged(path: Path, error: Exception) -> SettingError:
    text = str(error).partition("\n")[0]
    return SettingError(f"{path / METRICS} is damaged: {type(error).__name__}: {text}")


def labels_of(paths: Sequence[Path]) -> list[str]:
    """Names of directories, with as many of their parents as tell them apart."""
    absolute = [path.absolute() for path in paths]
    labels = [path.name or str(path) for path in absolute]
    for length in range(2, max(len(path.parts) for path in absolute) + 1):
        clashing = {name for name, same in grouped(labels, str).items() if len(same) > 1}
        labels = [
            "/".join(path.parts[-length:]) if label in clashing else label
            for label, path in zip(labels, absolute, strict=True)
        ]
    return labels
