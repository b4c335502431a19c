"""Learning curves: success over environment steps, median and quartiles over seeds."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from cgm_jax.results.figures.labels import counted_runs, remarks
from cgm_jax.results.figures.layout import Line, arrange, colour_setting
from cgm_jax.results.figures.panels import (
    add_legend,
    label_steps,
    label_success,
    legend_width,
    make_panels,
)
from cgm_jax.results.figures.runs import Rows, check_seeds, curves_of, rows_of, runs_of

QUARTILES = (25, 50, 75)


def learning_curves(rows: Rows) -> Figure:
    """Success rate over environment steps.

    A line per value of one setting (see `layout.colour_setting`), panels for the others. A cross
    marks where a run diverged; from there on its curve is that of its last finite policy. Where
    some runs of a line ended before others, the others continue as thin lines, since a median of
    those alone would be one of the worst, or of the best.

    Raises:
        ValueError: runs differ in what no row tells.
    """
    runs = runs_of(rows)
    panels = arrange(runs, colour_setting(runs))
    wide = legend_width([[line.label for line in panel.lines] for panel in panels])
    figure, axes = make_panels(len(panels), width=5.0 + wide, height=4.0, columns=3)
    for axis, panel in zip(axes, panels, strict=True):
        for line in panel.lines:
            check_seeds(line.runs)
            _draw_success(axis, line)
        axis.axhline(0.5, color="grey", linewidth=0.8, linestyle=":")
        axis.set_title(panel.title, fontsize=10)
        axis.set_xlim(0, 1.03 * max(run.last_steps for run in panel.runs))
        label_steps(axis)
        label_success(axis, "success rate, full goal")
        add_legend(axis)
    return figure


def _draw_success(axis: Axes, line: Line) -> None:
    """One line of learning curves, with a cross for every run that diverged."""
    steps, curves = curves_of(rows_of(line.runs), "success_rate")
    ends = np.array([run.last_steps for run in line.runs])
    common = steps <= ends.min()
    label = (line.label or counted_runs(line.runs)) + remarks(line.runs)
    draw_quartiles(axis, steps[common], curves[:, common], label, line.colour, line.style)
    for curve, end in zip(curves, ends, strict=True):
        if end > ends.min():
            rest = (steps >= ends.min()) & (steps <= end)
            axis.plot(
                steps[rest], curve[rest], line.style, color=line.colour, linewidth=0.6, alpha=0.6
            )
            axis.plot(end, curve[steps == end], ".", color=line.colour, markersize=4)
    for run in line.runs:
        if (row := run.failed_row) is not None:
            height = row["success_rate"] or 0.0
            axis.plot(row["env_steps"], height, "x", color=line.colour, zorder=4, clip_on=False)


def draw_quartiles(
    panel: Axes,
    steps: np.ndarray,
    curves: np.ndarray,
    label: str,
    colour: Any = None,
    style: str = "-",
) -> None:
    """Median line and quartile band of curves [runs, epochs] over those that have a value.

    The line is broken where none has one; a point without neighbours is a dot, its quartiles a bar.
    """
    known = np.isfinite(curves).any(axis=0)
    low, median, high = np.full((3, len(steps)), np.nan)
    if known.any():
        bands = np.nanpercentile(curves[:, known], QUARTILES, axis=0)
        low[known], median[known], high[known] = bands
    (line,) = panel.plot(steps, median, style, label=label, color=colour)
    around = np.pad(known, 1)
    lonely = known & ~around[:-2] & ~around[2:]
    if lonely.any():
        line.set_marker("o")
        line.set_markersize(4)
        line.set_markevery(np.flatnonzero(lonely).tolist())
    if len(curves) > 1:
        shade = line.get_color()
        panel.fill_between(steps, low, high, color=shade, alpha=0.2, linewidth=0)
        if lonely.any():
            bars = (steps[lonely], low[lonely], high[lonely])
            panel.vlines(*bars, color=shade, alpha=0.4, linewidth=3)
