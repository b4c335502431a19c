"""The paper's Fig. 4: success over training, with and without CGM, one panel per task."""

from collections.abc import Sequence
from typing import Any

from matplotlib.figure import Figure

from cgm_jax.figures import curves_of, draw_quartiles, label_steps, label_success, make_panels
from experiments.tables import runs_by_setting

COLOURS = {False: "tab:orange", True: "tab:blue"}
"""By whether HER is on."""


def comparison(rows: Sequence[dict[str, Any]]) -> Figure:
    """Median and quartiles over seeds; a line per algorithm, dashed without CGM."""
    settings = runs_by_setting(rows)
    tasks = sorted({setting[0] for setting in settings})
    figure, axes = make_panels(len(tasks), width=6.0, height=4.2)
    for panel, task in zip(axes, tasks, strict=True):
        for (env, her, cgm, c_g, kappa), seeds in settings.items():
            if env != task:
                continue
            label = "DDPG + HER" if her else "DDPG"
            label += f" + CGM ($c_g$ = {100 * c_g:g} %, $\\kappa$ = {kappa:g})" if cgm else ""
            steps, values = curves_of(
                [row for run in seeds.values() for row in run], "success_rate"
            )
            draw_quartiles(
                panel,
                steps,
                values,
                f"{label}, {_count(len(seeds))}",
                COLOURS[her],
                "-" if cgm else "--",
            )
        panel.set_title(task.replace("_", "-"))
        panel.axhline(0.5, color="grey", linewidth=0.8, linestyle=":")
        label_steps(panel)
        label_success(panel, "success rate, full goal")
        panel.legend(fontsize=8, loc="upper left", framealpha=0.7)
    return figure


def _count(seeds: int) -> str:
    return "1 seed" if seeds == 1 else f"{seeds} seeds"
