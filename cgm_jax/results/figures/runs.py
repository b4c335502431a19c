"""The runs behind the rows of a metrics.jsonl, and the settings that tell them apart."""

import itertools
from collections import defaultdict
from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeVar

import numpy as np

Row = dict[str, Any]
Rows = Sequence[Row]
Item = TypeVar("Item")
Key = TypeVar("Key", bound=Hashable)

ALWAYS = ("env", "agent", "curriculum", "her", "c_g", "kappa")
"""Settings that every row has; `swept` in a row names further ones."""

NO_VALUE = "none"
"""Stands for null where that is a value of a setting, and not the lack of the setting."""


class NothingToDraw(ValueError):  # noqa: N818 -- no error of the program
    """Why a figure would be empty.

    Attributes:
        missed: whether who trained these runs would look for the figure; else it makes no sense for
            what was asked, and nothing need be said.
    """

    def __init__(self, reason: str, *, missed: bool = False) -> None:
        super().__init__(reason)
        self.missed = missed


@dataclass(frozen=True)
class TrainedRun:
    """One run of a sweep.

    Attributes:
        name: tells it from the others.
        seed: what it may differ in from runs of the same settings.
        settings: value by name; None for a setting that the run does not have.
        rows: its rows of metrics.jsonl, epoch by epoch.
    """

    name: str
    seed: int
    settings: Mapping[str, Any]
    rows: Rows

    @property
    def last_steps(self) -> int:
        """Environment steps that it was trained for."""
        return self.rows[-1]["env_steps"]

    @property
    def failed_row(self) -> Row | None:
        """The row of the epoch in which it diverged."""
        return next((row for row in self.rows if row.get("failed_epoch") == row["epoch"]), None)

    @property
    def never_valid(self) -> bool:
        """Whether no evaluation had a valid episode."""
        return all(row["success_rate"] is None for row in self.rows)


def runs_of(rows: Rows) -> list[TrainedRun]:
    """The runs of a metrics.jsonl, in order of first appearance.

    Null is the lack of a setting (c_g without CGM), unless another run differs in nothing but
    having a value: then null is a value itself.
    """
    runs = []
    for name, own in grouped(rows, lambda row: row["run"]).items():
        settings = {key: _hashable(value) for key, value in _settings(own[-1]).items()}
        runs.append(TrainedRun(name, own[0]["seed"], settings, own))
    for name in _all_names(runs):
        if _null_is_a_value(runs, name):
            runs = [
                replace(run, settings={**run.settings, name: NO_VALUE})
                if run.settings.get(name) is None
                else run
                for run in runs
            ]
    return runs


def differing(runs: Sequence[TrainedRun]) -> list[str]:
    """Names of the settings in which runs differ, the seed aside."""
    return [
        name
        for name in _all_names(runs)
        if len({run.settings.get(name) for run in runs} - {None}) > 1
    ]


def by_settings(runs: Sequence[TrainedRun]) -> list[list[TrainedRun]]:
    """Runs that differ in the seed only, together.

    Raises:
        ValueError: some have their seed in common too, so they differ in what no row tells.
    """
    names = _all_names(runs)
    groups = grouped(runs, lambda run: tuple(run.settings.get(name) for name in names))
    for same in groups.values():
        check_seeds(same)
    return list(groups.values())


def check_seeds(runs: Sequence[TrainedRun]) -> None:
    """Make sure that runs which count as repetitions are such.

    Raises:
        ValueError: two have the same seed, so they differ in what no row tells.
    """
    for seed, same in grouped(runs, lambda run: run.seed).items():
        if len(same) > 1:
            names = f"{same[0].name} and {same[1].name}"
            raise ValueError(f"{names} have seed {seed}, and no row tells what else differs")


def curves_of(
    rows: Rows, value: str | Callable[[Row], float | None]
) -> tuple[np.ndarray, np.ndarray]:
    """env_steps [epochs] and values [runs, epochs]; NaN where a run has no value."""
    read = value if callable(value) else lambda row: row[value]
    steps = sorted({row["env_steps"] for row in rows})
    place = {step: i for i, step in enumerate(steps)}
    runs = grouped(rows, lambda row: row["run"])
    curves = np.full((len(runs), len(steps)), np.nan)
    for curve, run in zip(curves, runs.values(), strict=True):
        for row in run:
            number = read(row)
            curve[place[row["env_steps"]]] = np.nan if number is None else number
    return np.array(steps, float), curves


def rows_of(runs: Sequence[TrainedRun]) -> list[Row]:
    """The rows of several runs."""
    return list(itertools.chain.from_iterable(run.rows for run in runs))


def rows_while_all_ran(runs: Sequence[TrainedRun]) -> list[Row]:
    """Their rows up to where the first of them ended.

    What is drawn over several runs ends there: the rest would be of the slowest alone, or the best.
    """
    first_end = min(run.last_steps for run in runs)
    return [row for row in rows_of(runs) if row["env_steps"] <= first_end]


def mean_success(runs: Sequence[TrainedRun], horizon: int) -> float:
    """Mean success of runs over so many environment steps, at least as many as they took.

    One that ended before, as it may once it holds a success, counts on with its last one. An
    evaluation without a valid episode is no success.
    """
    total = 0.0
    for run in runs:
        steps = [0, *(row["env_steps"] for row in run.rows)]
        rates = [row["success_rate"] or 0.0 for row in run.rows]
        total += float(np.diff(steps) @ rates) + rates[-1] * (horizon - steps[-1])
    return total / (len(runs) * horizon)


def grouped(items: Sequence[Item], key: Callable[[Item], Key]) -> dict[Key, list[Item]]:
    """Items by key, in order of first appearance."""
    groups: dict[Key, list[Item]] = defaultdict(list)
    for item in items:
        groups[key(item)].append(item)
    return dict(groups)


def _settings(row: Row) -> Row:
    names = (*ALWAYS, *row.get("swept", ()))
    settings = {"agent": "ddpg", **{name: row[name] for name in names if name in row}}
    if "curriculum" not in row:  # from before there were several
        settings["curriculum"] = "cgm" if row["cgm"] else "full"
        if not row["cgm"]:
            settings |= {"c_g": None, "kappa": None}
    return settings


def _hashable(value: Any) -> Hashable:
    return tuple(_hashable(item) for item in value) if isinstance(value, list) else value


def _all_names(runs: Sequence[TrainedRun]) -> list[str]:
    return list(dict.fromkeys([*ALWAYS, *(name for run in runs for name in run.settings)]))


def _null_is_a_value(runs: Sequence[TrainedRun], name: str) -> bool:
    others = [other for other in _all_names(runs) if other != name]
    groups = grouped(
        runs, lambda run: (run.seed, *(run.settings.get(other) for other in others))
    ).values()
    return any(len({run.settings.get(name) is None for run in same}) > 1 for same in groups)
