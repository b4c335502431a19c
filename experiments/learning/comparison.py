"""The paper's Fig. 4: success over training, with and without CGM, one panel per task."""

from collections.abc import Sequence
from typing import Any

from matplotlib.figure import Figure

from cgm_jax.report.figures import (
    curves_of,
    draw_quartiles,
    label_steps,
    label_success,
    make_panels,
)
from experiments.learning.tables import Setting, runs_by_setting


def comparison(rows: Sequence[dict[str, Any]]) -> Figure:
    """Median and quartiles over seeds; a line per algorithm, dashed without CGM.

    DDPG in warm colours, DDPG + HER in cold ones, in grey where hindsight comes from all episodes;
    dotted lines are the other ways to draw masks.
    The numbers behind CGM are c_g and kappa.
    """
    settings = runs_by_setting(rows)
    tasks = sorted({setting.env for setting in settings})
    figure, axes = make_panels(len(tasks), width=6.0, height=4.8)
    for panel, task in zip(axes, tasks, strict=True):
        for setting, seeds in settings.items():
            if setting.env != task:
                continue
            steps, values = curves_of(
                [row for run in seeds.values() for row in run], "success_rate"
            )
            colour, style = _look(setting)
            label = f"{setting.algorithm}, {setting.curriculum}, {_count(len(seeds))}"
            draw_quartiles(panel, steps, values, label, colour, style)
        panel.set_title(task.replace("_", "-"))
        panel.axhline(0.5, color="grey", linewidth=0.8, linestyle=":")
        label_steps(panel)
        label_success(panel, "success rate, full goal")
        panel.legend(fontsize=8, loc="upper center", bbox_to_anchor=(0.5, -0.14), frameon=False)
    return figure


def _look(setting: Setting) -> tuple[str, str]:
    """Colour and style of a line."""
    if setting.her and not setting.her_filter:
        return "dimgray", "-" if setting.cgm else "--"
    if setting.kappa == 0:
        return ("tab:cyan" if setting.her else "gold"), ":"
    if setting.estimate == "joint":
        return ("tab:purple" if setting.her else "tab:red"), ":"
    if setting.estimate == "measured":
        return ("tab:green" if setting.her else "tab:brown"), ":"
    return ("tab:blue" if setting.her else "tab:orange"), "-" if setting.cgm else "--"


def _count(seeds: int) -> str:
    return "1 seed" if seeds == 1 else f"{seeds} seeds"
