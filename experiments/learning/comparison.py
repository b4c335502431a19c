"""The paper's Fig. 4: success over training, with and without CGM, one panel per task."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from cgm_jax.results.figures import (
    curves_of,
    draw_quartiles,
    label_steps,
    label_success,
    make_panels,
)
from experiments.learning.paired import SEEDS_OF_A_CLAIM
from experiments.learning.records import RecordedRun
from experiments.learning.setting import NO_MASKS, UNIFORM, Setting
from experiments.learning.tables import Runs, left_early, metrics_of, runs_by_setting
from experiments.markdown import counted
from experiments.table import read_table

DOING_NOTHING = Path(__file__).parents[1] / "results" / "doing_nothing" / "doing_nothing.csv"


def comparison(runs: Runs) -> Figure:
    """Median over seeds, from ten on with quartiles, and every seed; dashed without masks.

    DDPG in warm colours, DDPG + HER in cold ones, in greys where hindsight comes from all episodes;
    dotted lines are the other ways to draw masks. The numbers behind CGM are c_g and kappa. A thin
    dotted line is the success of a policy that does nothing.
    """
    settings = runs_by_setting(runs)
    tasks = sorted({setting.task for setting in settings})
    nothing = {row["task"]: float(row["success"]) for row in read_table(DOING_NOTHING)}
    figure, axes = make_panels(len(tasks), width=6.0, height=4.8)
    for panel, task in zip(axes, tasks, strict=True):
        of_task = {key: seeds for key, seeds in settings.items() if key.task == task}
        looks = looks_of(list(of_task))
        for setting, seeds in of_task.items():
            _draw(panel, seeds, looks[setting], _label(setting, list(of_task)))
        panel.set_title(task)
        panel.axhline(0.5, color="grey", linewidth=0.8, linestyle=":")
        if task.replace("-", "_") in nothing:
            rate = nothing[task.replace("-", "_")]
            panel.axhline(rate, color="black", linewidth=0.8, linestyle=":")
        label_steps(panel)
        label_success(panel, "success rate, full goal")
        panel.legend(fontsize=8, loc="upper center", bbox_to_anchor=(0.5, -0.14), frameon=False)
    return figure


def _draw(panel: Axes, seeds: Mapping[int, RecordedRun], look: tuple[str, str], label: str) -> None:
    """A line for the median of the runs, as far as all of them were trained.

    With quartiles from ten seeds on; and a thin line for every seed, with a dot where it left.
    """
    colour, style = look
    label = f"{label}, {counted(len(seeds), 'seed')}"
    steps, curves = curves_of(metrics_of(list(seeds.values())), "success_rate")
    there = np.isfinite(curves).all(axis=0)
    if len(seeds) >= SEEDS_OF_A_CLAIM:
        draw_quartiles(panel, steps[there], curves[:, there], label, colour, style)
    else:
        median = np.median(curves[:, there], axis=0)
        panel.plot(steps[there], median, style, color=colour, label=label)
    if len(seeds) == 1:
        return
    for run, curve in zip(seeds.values(), curves, strict=True):
        known = np.isfinite(curve)
        panel.plot(steps[known], curve[known], style, color=colour, linewidth=0.6, alpha=0.5)
        if left_early(run):
            panel.plot(steps[known][-1], curve[known][-1], ".", color=colour)


def _label(setting: Setting, panel: Sequence[Setting]) -> str:
    """What tells a line from the others of its panel."""
    parts = [setting.algorithm, setting.curriculum]
    if len({other.random_action_steps for other in panel}) > 1:
        parts.append(f"random actions of {counted(setting.random_action_steps, 'step')}")
    return ", ".join(parts)


SPARE_LOOKS = [("tab:olive", "-."), ("tab:pink", "-."), ("tab:gray", "-."), ("black", "-.")]
"""For settings that would look like another of their panel."""


def looks_of(panel: Sequence[Setting]) -> dict[Setting, tuple[str, str]]:
    """Colour and style of every line of a panel, no two alike as far as there are spare ones."""
    looks: dict[Setting, tuple[str, str]] = {}
    for setting in panel:
        looks[setting] = next(
            (one for one in (look(setting), *SPARE_LOOKS) if one not in looks.values()),
            look(setting),
        )
    return looks


def look(setting: Setting) -> tuple[str, str]:
    """Colour and style of a line."""
    column = 0 if not setting.her else 1 if setting.her_filter else 2
    if setting.masks == NO_MASKS:
        return ("tab:orange", "tab:blue", "dimgray")[column], "--"
    if setting.masks == UNIFORM:
        return ("gold", "tab:cyan", "darkgray")[column], ":"
    if setting.masks == "CGM, masks measured":
        return ("tab:brown", "tab:green", "darkseagreen")[column], ":"
    return ("tab:orange", "tab:blue", "black")[column], "-"
