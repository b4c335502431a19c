"""What curricula report of themselves (see `report` in curricula/protocol.py), over training.

A number per epoch is a line; several are a heat map over environment steps. An array `a_b` [k]
belongs to an array `a` [k] of the same report, if there is one: its values then name the rows.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from cgm_jax.results.figures.curves import draw_quartiles
from cgm_jax.results.figures.labels import (
    counted_runs,
    line_text,
    naming_array,
    remark_parts,
    remarks,
    setting_text,
    title_text,
)
from cgm_jax.results.figures.layout import spread_colours
from cgm_jax.results.figures.masks import best_setting, mask_label
from cgm_jax.results.figures.panels import (
    add_legend,
    label_steps,
    legend_width,
    make_panels,
    say_empty,
)
from cgm_jax.results.figures.runs import (
    ALWAYS,
    NothingToDraw,
    Rows,
    TrainedRun,
    by_settings,
    curves_of,
    differing,
    grouped,
    rows_of,
    rows_while_all_ran,
    runs_of,
)

MAX_TICKS = 16


def curriculum(rows: Rows) -> Figure:
    """All that curricula report, a panel per environment, curriculum and key.

    Lines are medians over the seeds of every setting; heat maps are means over the seeds of the
    setting with most success, which their titles name. Both end where the first of the seeds did.

    Raises:
        NothingToDraw: no curriculum reports anything.
        ValueError: runs differ in what no row tells.
    """
    runs = runs_of(rows)
    names = differing(runs)
    groups = grouped(runs, lambda run: (run.settings["env"], run.settings["curriculum"]))
    shown = [(same, key) for same in groups.values() for key in _reported(same)]
    if not shown:
        raise NothingToDraw("its curricula report nothing")
    labels = [_labels(same, names) for same, _ in shown]
    figure, panels = make_panels(
        len(shown), width=5.0 + legend_width(labels), height=3.6, columns=3
    )
    for panel, (same, key) in zip(panels, shown, strict=True):
        if any(isinstance(row.get(key), list) for row in rows_of(same)):
            _draw_array(panel, best_setting(same), key, names)
        else:
            _draw_number(panel, same, key, names)
        panel.set_xlim(0, max(run.last_steps for run in same))
        label_steps(panel)
    return figure


def _reported(runs: Sequence[TrainedRun]) -> list[str]:
    """Keys of a curriculum's report, less those that only name the rows of others."""
    keys = dict.fromkeys(key for row in rows_of(runs) for key in row.get("reported") or ())
    names = {
        naming_array(key, np.size(row[key]), row)
        for row in rows_of(runs)
        for key in keys
        if isinstance(row.get(key), list)
    }
    return [key for key in keys if key not in names]


def _labels(runs: Sequence[TrainedRun], names: Sequence[str]) -> list[str]:
    told = [name for name in names if name not in ("env", "curriculum")]
    return [line_text(same[0].settings, told) or counted_runs(same) for same in by_settings(runs)]


def _draw_number(panel: Axes, runs: Sequence[TrainedRun], key: str, names: Sequence[str]) -> None:
    settings = by_settings(runs)
    drawn = zip(settings, _labels(runs, names), spread_colours(len(settings)), strict=True)
    for same, label, colour in drawn:
        steps, curves = curves_of(rows_while_all_ran(same), lambda row: row.get(key))
        draw_quartiles(panel, steps, curves, label + remarks(same), colour)
    first = runs[0].settings
    of_whom = [setting_text(name, first[name]) for name in ("env", "curriculum")]
    panel.set_title(", ".join(of_whom), fontsize=10)
    panel.set_ylabel(key.replace("_", " "))
    add_legend(panel)


def _draw_array(panel: Axes, runs: Sequence[TrainedRun], key: str, names: Sequence[str]) -> None:
    rows = [row for row in rows_while_all_ran(runs) if isinstance(row.get(key), list)]
    sizes = {np.size(row[key]) for row in rows}
    told = list(dict.fromkeys([*ALWAYS, *names]))
    further = [f"mean of {len(runs)} runs"] if len(runs) > 1 else []
    panel.set_title(title_text(runs, told, further + remark_parts(runs)), fontsize=10)
    panel.grid(visible=False)
    if not rows:
        say_empty(panel, f"{key}: no value while all runs trained")
        return
    (size,) = sizes
    flat = [{**row, key: _flat(row[key])} for row in rows]
    columns = [curves_of(flat, lambda row, i=i: row[key][i]) for i in range(size)]
    steps = columns[0][0]
    values = np.array([_mean(curves) for _, curves in columns])
    if not np.isfinite(values).any():
        say_empty(panel, f"{key}: no value while all runs trained")
        return
    edges = np.concatenate([[0.0], steps])
    panel.set_facecolor("lightgrey")  # of what has no value
    least = min(0.0, float(np.nanmin(values)))
    drawn = panel.pcolormesh(
        edges, np.arange(size + 1) - 0.5, np.ma.masked_invalid(values), vmin=least, cmap="viridis"
    )
    bar = panel.figure.colorbar(drawn, ax=panel)  # pyright: ignore[reportAttributeAccessIssue]
    bar.set_label(key.replace("_", " "))
    _name_rows(panel, rows, key, size)


def _flat(value: Any) -> list[Any]:
    return np.array(value, object).ravel().tolist()


def _mean(curves: np.ndarray) -> np.ndarray:
    """Mean [epochs] of curves [runs, epochs] over runs with a value; NaN where none has one."""
    known = np.isfinite(curves)
    count = known.sum(axis=0)
    total = np.where(known, curves, 0.0).sum(axis=0)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


def _shown_rows(size: int) -> np.ndarray:
    """Rows to name: the first, the last and some between, evenly spaced where that is possible."""
    even = [count for count in range(6, MAX_TICKS + 1) if (size - 1) % (count - 1) == 0]
    count = max(even, default=MAX_TICKS) if size > MAX_TICKS else size
    return np.unique(np.linspace(0, size - 1, count).round().astype(int))


def _name_rows(panel: Axes, rows: Rows, key: str, size: int) -> None:
    """Tick labels of a heat map: of masks what they keep, else the values that a row gives."""
    kind = key.partition("_")[0]
    shown = _shown_rows(size)
    if name := naming_array(key, size, rows[-1]):
        named = rows[-1][name]
        texts = ["-" if named[i] is None else f"{named[i]:.3g}" for i in shown]
        kind = name
    elif kind == "mask" and size == 1 << (size.bit_length() - 1):
        texts = [mask_label(int(i), size.bit_length() - 1) for i in shown]
        kind = "kept dimensions"
    else:
        texts = [str(i) for i in shown]
        kind = f"{kind}, by number"
    panel.set_yticks(shown, texts, fontsize=8)
    panel.set_ylabel(kind)
