"""Many settings beside each other: success over training, and when every seed held 90 %.

A column per task. Above, a line per setting, the median over its seeds; below, a row per setting
with a mark per seed, in the line's colour, which names the line, too.
"""

import textwrap
from collections.abc import Mapping, Sequence
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from cgm_jax.results.figures import curves_of, label_steps, label_success
from experiments.learning.records import RecordedRun
from experiments.learning.setting import Setting
from experiments.learning.tables import (
    Runs,
    env_steps_to_hold,
    is_settled,
    left_early,
    metrics_of,
    runs_by_setting,
)
from experiments.markdown import counted, percent

LEVEL = 0.9
LABEL_WIDTH = 38
"""Characters, of which two lines fit into a row."""

Look = dict[str, Any]

LOOKS: Sequence[Look] = [
    {"color": colour, "marker": marker, "linestyle": style}
    for colour, marker, style in (
        ("black", "o", "--"),
        ("tab:blue", "s", "-"),
        ("tab:orange", "^", "-"),
        ("tab:green", "v", "-"),
        ("tab:red", "D", "-"),
        ("tab:purple", "P", "-"),
        ("tab:brown", "X", "-"),
        ("tab:pink", "<", "-"),
        ("tab:olive", ">", "-"),
        ("tab:cyan", "*", "-"),
        ("tab:blue", "o", ":"),
        ("tab:red", "s", ":"),
        ("tab:green", "D", ":"),
        ("tab:purple", "^", ":"),
    )
]
"""Each told from the others by its marker and style too, not by its colour alone."""


def overview(runs: Runs) -> Figure:
    """Success over training and the environment steps until 90 % is held, a column per task.

    A run that left once it held 90 % counts for the rest of its training with its last success, so
    that the median is one of all seeds throughout. A cross is a run that did not hold 90 %, where
    its training ended.

    Raises:
        ValueError: more settings than can be told apart.
    """
    settings = runs_by_setting(runs)
    names = _names(list(settings))
    if len(set(names.values())) > len(LOOKS):
        raise ValueError(f"{len(set(names.values()))} lines cannot be told apart")
    looks = dict(zip(dict.fromkeys(names.values()), LOOKS, strict=False))
    tasks = list(dict.fromkeys(setting.task for setting in settings))
    rows = len(looks)
    figure, panels = plt.subplots(
        2,
        len(tasks),
        figsize=(7.0 * len(tasks), 4.5 + 0.4 * rows),
        height_ratios=[4.0, 0.5 + 0.4 * rows],
        squeeze=False,
        sharex="col",
        layout="constrained",
    )
    for (above, below), task in zip(panels.T, tasks, strict=True):
        of_task = {names[key]: seeds for key, seeds in settings.items() if key.task == task}
        for name, seeds in of_task.items():
            _draw_median(above, list(seeds.values()), name, looks[name])
        _draw_arrivals(below, of_task, looks)
        above.set_title(task)
        above.axhline(LEVEL, color="grey", linewidth=0.8, linestyle=":")
        label_success(above, "success rate, full goal")
        above.grid(alpha=0.25)
        label_steps(below)
        below.set_xlim(left=0)
        below.set_title(f"{percent(LEVEL)} held, every seed (x: not held)", fontsize=10)
    return figure


def _names(settings: Sequence[Setting]) -> dict[Setting, str]:
    """What each setting is called: all that is not the same in all settings of some task."""
    parts = {
        setting: (
            setting.algorithm,
            f"random actions of {counted(setting.random_action_steps, 'step')}",
            setting.curriculum,
        )
        for setting in settings
    }
    by_task = [
        [own for setting, own in parts.items() if setting.task == task]
        for task in {setting.task for setting in settings}
    ]
    columns = zip(*(zip(*rows, strict=True) for rows in by_task), strict=True)
    told = [any(len(set(values)) > 1 for values in column) for column in columns]
    if not any(told):
        return {setting: setting.curriculum for setting in settings}
    return {
        setting: ", ".join(part for part, differs in zip(own, told, strict=True) if differs)
        for setting, own in parts.items()
    }


def _draw_median(panel: Axes, runs: Sequence[RecordedRun], name: str, look: Look) -> None:
    steps, curves = curves_of(metrics_of(runs), "success_rate")
    for run, curve in zip(runs, curves, strict=True):
        known = np.flatnonzero(np.isfinite(curve))
        if len(known) and left_early(run):
            curve[known[-1] :] = curve[known[-1]]
    there = np.isfinite(curves).all(axis=0)
    median = np.median(curves[:, there], axis=0)
    shape = {"markevery": 0.12, "markersize": 5, "linewidth": 1.4}
    panel.plot(steps[there], median, label=name, **shape, **look)


def is_held(run: RecordedRun) -> bool:
    """Whether a run held 90 %, as far as it was trained."""
    return np.isfinite(env_steps_to_hold(run, LEVEL))


def _draw_arrivals(
    panel: Axes, settings: Mapping[str, Mapping[int, RecordedRun]], looks: Mapping[str, Look]
) -> None:
    """A row per setting in order, from the top; seeds that did not arrive are crosses."""
    labels = []
    for row, (name, seeds) in enumerate(settings.items()):
        colour, marker = looks[name]["color"], looks[name]["marker"]
        runs = [run for run in seeds.values() if is_settled(run, LEVEL)]
        for place, run in zip(_places(len(runs)), runs, strict=True):
            held = is_held(run)
            steps = env_steps_to_hold(run, LEVEL) if held else run.rows[-1]["env_steps"]
            shape = {"marker": marker if held else "x", "markersize": 5}
            panel.plot(steps, row + place, linestyle="", color=colour, **shape)
        labels.append(textwrap.fill(f"{name}, {counted(len(seeds), 'seed')}", LABEL_WIDTH))
    panel.set_yticks(range(len(labels)), labels, fontsize=8)
    for tick, name in zip(panel.get_yticklabels(), settings, strict=True):
        tick.set_color(looks[name]["color"])
    panel.set_ylim(len(labels) - 0.5, -0.5)
    panel.grid(axis="y", alpha=0.25)


def _places(count: int) -> np.ndarray:
    """Where the seeds of a row stand, so that those that arrive together are seen."""
    return np.linspace(-0.25, 0.25, count) if count > 1 else np.zeros(count)
