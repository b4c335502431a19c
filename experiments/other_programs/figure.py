"""Success of all arms by CPU seconds and by environment steps, one row of panels per task."""

from collections import defaultdict
from collections.abc import Mapping, Sequence
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import LogLocator, NullFormatter

from experiments.markdown import counted
from experiments.other_programs.arms import NAMES, TASKS, label
from experiments.other_programs.runs import runs_made
from experiments.table import read_table

AXES = {"cpu_s": "CPU seconds, one core", "env_steps": "environment steps"}
COLOURS = dict(
    zip(NAMES, ("tab:blue", "tab:cyan", "tab:red", "tab:orange", "tab:brown"), strict=True)
)
Curve = Mapping[str, np.ndarray]


def curves_in(out: Path) -> dict[tuple[str, str], list[Curve]]:
    """Curves by task and arm, one per seed: arrays by column."""
    found: dict[tuple[str, str], list[Curve]] = defaultdict(list)
    for run in runs_made(out):
        rows = read_table(run.path(out))
        columns = {x: np.array([float(row[x]) for row in rows]) for x in rows[0]}
        found[run.task, run.arm].append(columns)
    return dict(found)


def draw(out: Path) -> Path:
    """Draw the curves in OUT into OUT/comparison.png; the path.

    Raises:
        ValueError: there is no curve.
    """
    curves = curves_in(out)
    tasks = [task for task in TASKS if any(key[0] == task for key in curves)]
    if not tasks:
        raise ValueError(f"{out}: there is no curve")
    size = (12.0, 4.6 * len(tasks))
    shape = {"figsize": size, "squeeze": False, "sharey": True, "layout": "constrained"}
    figure, panels = plt.subplots(len(tasks), 2, **shape)
    for row, task in zip(panels, tasks, strict=True):
        for panel, (axis, title) in zip(row, AXES.items(), strict=True):
            for arm in NAMES:
                draw_arm(panel, curves.get((task, arm), []), axis, arm)
            panel.set_xscale("log")
            panel.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
            panel.xaxis.set_major_formatter(lambda value, _: f"{value:,.0f}")
            panel.xaxis.set_minor_formatter(NullFormatter())
            panel.set_xlabel(title)
            panel.set_title(task.replace("_", "-"))
            panel.grid(alpha=0.3)
        row[0].set_ylabel("success rate, full goal")
        row[0].set_ylim(-0.02, 1.02)
        row[0].legend(fontsize=8, loc="upper center", bbox_to_anchor=(0.5, -0.14))
    path = out / "comparison.png"
    figure.savefig(path, dpi=130)
    plt.close(figure)
    return path


def draw_arm(panel: Axes, seeds: Sequence[Curve], axis: str, arm: str) -> None:
    """A line for every seed; the first carries the label."""
    for i, curve in enumerate(seeds):
        named = f"{label(arm)}, {counted(len(seeds), 'seed')}" if i == 0 else None
        panel.plot(curve[axis], curve["success_rate"], color=COLOURS[arm], label=named, lw=1.4)
