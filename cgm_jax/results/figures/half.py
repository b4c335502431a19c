"""Epochs until 50 % success is held, over the values of one setting (the paper's Fig. 3)."""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from cgm_jax.results.figures.labels import remarks, setting_text, value_text
from cgm_jax.results.figures.layout import Line, Panel, arrange, colour_setting, order
from cgm_jax.results.figures.panels import add_legend, legend_width, make_panels
from cgm_jax.results.figures.runs import (
    NothingToDraw,
    Row,
    Rows,
    TrainedRun,
    check_seeds,
    differing,
    grouped,
    runs_of,
)
from cgm_jax.results.statistics import first_to_hold, quartiles

WIDE = 30.0
"""Values whose largest is so many times the smallest stand on a logarithmic axis."""


class Point(NamedTuple):
    """What became of runs that differ in the seed only; in epochs or environment steps.

    Attributes:
        low: lower quartile of when they held 50 %, at most `last`.
        median: of that.
        high: upper quartile.
        reached: whether the median run did.
        last: how long they were trained; if the median run never held 50 %, how long it is known
            not to have.
    """

    low: float
    median: float
    high: float
    reached: bool
    last: float


class Axis(NamedTuple):
    """The horizontal axis.

    Attributes:
        name: the setting.
        places: where each value stands.
        in_order: whether values are numbers, so that a line between them means something.
    """

    name: str
    places: dict[Any, float]
    in_order: bool


def epochs_to_half(rows: Rows) -> Figure:
    """Epochs to 50 % success over c_g or kappa; where neither differs, over what else does.

    A run is there once the mean of three evaluations holds 50 %. Medians over seeds, and quartiles
    as dashed lines. Where a median run never gets there, its point is open and stands at the last
    place at which it is known not to be there: where training ended, if all runs were trained
    alike. Runs without the setting are level lines. Where epochs differ in length, environment
    steps take their place.

    Raises:
        NothingToDraw: runs differ in nothing that could be an axis.
        ValueError: runs differ in what no row tells.
    """
    runs = runs_of(rows)
    over = _setting_over_which(runs)
    if over is None:
        raise NothingToDraw("its runs differ in the seed and the environment at most")
    names = differing(runs)
    colour = "kappa" if over != "kappa" and "kappa" in names else None
    panels = arrange(runs, colour, within=[over])
    wide = legend_width([[line.label for line in panel.lines] for panel in panels])
    figure, axes = make_panels(len(panels), width=5.0 + wide, height=4.0)
    axis = _axis(over, runs)
    for own_axes, panel in zip(axes, panels, strict=True):
        _draw_panel(own_axes, panel, axis)
    return figure


def _setting_over_which(runs: Sequence[TrainedRun]) -> str | None:
    names = differing(runs)
    return next((name for name in ("c_g", "kappa") if name in names), colour_setting(runs))


def _axis(name: str, runs: Sequence[TrainedRun]) -> Axis:
    values: list[Any] = sorted({run.settings.get(name) for run in runs} - {None}, key=order)
    if all(isinstance(value, int | float) and not isinstance(value, bool) for value in values):
        scale = 100 if name == "c_g" else 1
        return Axis(name, {value: scale * value for value in values}, in_order=True)
    return Axis(name, {value: float(i) for i, value in enumerate(values)}, in_order=False)


def _draw_panel(axes: Axes, panel: Panel, axis: Axis) -> None:
    lengths = {run.rows[-1]["env_steps"] / run.rows[-1]["epoch"] for run in panel.runs}
    unit = "epoch" if len(lengths) == 1 else "env_steps"
    points = []
    for line in panel.lines:
        without = [run for run in line.runs if run.settings.get(axis.name) is None]
        having = [run for run in line.runs if run.settings.get(axis.name) is not None]
        if having:
            points += _draw_points(axes, line, having, axis, unit)
        if without:
            point = _point(without, unit)
            points.append(point)
            _draw_level(axes, line, point, remarks(without))
    _decorate(axes, axis, points, unit, lengths)
    axes.set_title(panel.title, fontsize=10)
    add_legend(axes)


def _draw_points(
    axes: Axes, line: Line, runs: Sequence[TrainedRun], axis: Axis, unit: str
) -> list[Point]:
    """One line: quartiles over runs, at each value, of when they first hold 50 %."""
    by_value = sorted(
        grouped(runs, lambda run: run.settings[axis.name]).items(),
        key=lambda pair: axis.places[pair[0]],
    )
    points = [_point(same, unit) for _, same in by_value]
    places = np.array([axis.places[value] for value, _ in by_value])
    low, median, high, reached, _ = np.array(points).T
    reached = reached.astype(bool)
    colour, style = line.colour, line.style if axis.in_order else "none"
    several = any(len(same) > 1 for _, same in by_value)
    label = (line.label or ("median over seeds" if several else "one run each")) + remarks(runs)
    (drawn,) = axes.plot(places, median, linestyle=style, label=label, color=colour, zorder=3)
    axes.plot(places[reached], median[reached], "o", color=colour, zorder=4)
    axes.plot(places[~reached], median[~reached], "o", color=colour, mfc="white", zorder=4)
    if not axis.in_order:
        drawn.set_marker("o")  # for the legend
    if several:
        if axis.in_order and len(places) > 1:
            axes.plot(places, low, linestyle="--", linewidth=0.8, color=colour)
            axes.plot(places, high, linestyle="--", linewidth=0.8, color=colour)
        else:
            axes.vlines(places, low, high, color=colour, linewidth=0.8, linestyle="--")
    return points


def _draw_level(axes: Axes, line: Line, point: Point, remark: str) -> None:
    label = line.label or "without it"
    label += "" if point.reached else ", not reached"
    style = "-." if line.style == "-" else line.style
    axes.axhline(point.median, color=line.colour, linestyle=style, label=label + remark)


def _point(runs: Sequence[TrainedRun], unit: str) -> Point:
    check_seeds(runs)
    reached = [first_to_hold(run.rows, 0.5) for run in runs]
    low, median, high = quartiles([row[unit] if row else math.inf for row in reached])
    last = max(run.rows[-1][unit] for run in runs)
    if math.isinf(median):  # some may have left, or been stopped, long before others
        without = [_last_without(run, row)[unit] for run, row in zip(runs, reached, strict=True)]
        last = sorted(without)[len(runs) // 2]
    return Point(min(low, last), min(median, last), min(high, last), math.isfinite(median), last)


def _last_without(run: TrainedRun, reached: Row | None) -> Row:
    """The last row of a run before the one in which it held 50 %, if it ever did."""
    return run.rows[-1 if reached is None else run.rows.index(reached) - 1]


def _decorate(
    axes: Axes, axis: Axis, points: Sequence[Point], unit: str, lengths: set[float]
) -> None:
    """Axes, and what open points and epochs mean."""
    last = max(point.last for point in points)
    if not all(point.reached for point in points):
        _explain_open(axes, {point.last for point in points if not point.reached}, unit)
    if axis.name == "c_g":
        axes.set_xlabel("target success rate $c_g$ (%)")
    else:
        axes.set_xlabel("$\\kappa$" if axis.name == "kappa" else axis.name.replace("_", " "))
    places = list(axis.places.values())
    if not axis.in_order:
        texts = [_tick(axis.name, value) for value in axis.places]
        long = max(map(len, texts)) * len(texts) > 40
        axes.set_xticks(places, texts, rotation=30 if long else 0, ha="right" if long else "center")
        axes.set_xlim(-0.5, len(places) - 0.5)
    elif min(places) > 0 and max(places) > WIDE * min(places):
        axes.set_xscale("log")
    axes.set_ylim(0, last * 1.12)
    if unit == "epoch":
        (length,) = lengths
        axes.set_ylabel("epochs to 50 % success")
        axes.yaxis.set_major_locator(MaxNLocator(integer=True))
        axes.annotate(
            f"an epoch: {length:,.0f} env_steps",
            (0.98, 0.02),
            xycoords="axes fraction",
            horizontalalignment="right",
            fontsize=8,
            color="grey",
        )
    else:
        axes.set_ylabel("env_steps to 50 % success")
        axes.yaxis.set_major_formatter(lambda steps, _: f"{steps:,.0f}")


def _tick(name: str, value: Any) -> str:
    named = name in ("curriculum", "agent") or isinstance(value, bool)
    return setting_text(name, value) if named else value_text(value)


def _explain_open(axes: Axes, lasts: set[float], unit: str) -> None:
    last = max(lasts)
    text = "not within the training (open)"
    if len(lasts) == 1:
        axes.axhline(last, color="grey", linewidth=0.8, linestyle=":")
        name = unit if unit == "env_steps" else "epoch" if last == 1 else "epochs"
        text = f"not within {last:,} {name} (open)"
    axes.annotate(
        text,
        (0.02, last),
        xycoords=("axes fraction", "data"),
        xytext=(0, 5),
        textcoords="offset points",
        fontsize=8,
        color="grey",
    )
