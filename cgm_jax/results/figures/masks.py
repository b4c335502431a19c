"""Success of masked goals: what is estimated of each mask, and what training made of it."""

from collections.abc import Sequence

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from cgm_jax.results.figures.curves import draw_quartiles
from cgm_jax.results.figures.labels import remark_parts, title_text
from cgm_jax.results.figures.panels import (
    add_legend,
    label_steps,
    label_success,
    make_panels,
    say_empty,
)
from cgm_jax.results.figures.runs import (
    ALWAYS,
    NothingToDraw,
    Row,
    Rows,
    TrainedRun,
    by_settings,
    curves_of,
    differing,
    grouped,
    mean_success,
    rows_of,
    rows_while_all_ran,
    runs_of,
)
from cgm_jax.results.plan import AXES

ALL_MASKS = 8
"""Where there are more masks, only those of one dimension and the full goal are drawn."""

KINDS = (("mask_rate_estimated", "estimated"), ("mask_rate_training", "training"))


def mask_success(rows: Rows) -> Figure:
    """Estimated and training success per mask, for each curriculum of masks in its best setting.

    The paper's Fig. 5. A pair of panels per environment and curriculum; medians over seeds, up to
    where the first of them ended.

    Raises:
        NothingToDraw: no run drew masks, or goals have too many dimensions to count by mask.
        ValueError: runs differ in what no row tells.
    """
    runs = runs_of(rows)
    masked = [run for run in runs if _draws_masks(run)]
    if not masked and any("level_probability" in row for row in rows_of(runs)):
        raise NothingToDraw(
            "masks are too many to count each; curriculum.png shows them by success", missed=True
        )
    if not masked:
        raise NothingToDraw("no run drew masks")
    groups = grouped(masked, lambda run: (run.settings["env"], run.settings["curriculum"]))
    told = list(dict.fromkeys([*ALWAYS, *differing(runs)]))
    figure, panels = make_panels(2 * len(groups), width=5.0, height=4.0, columns=2)
    for pair, same in zip(
        zip(panels[::2], panels[1::2], strict=True), groups.values(), strict=True
    ):
        best = best_setting(same)
        for panel, (name, kind) in zip(pair, KINDS, strict=True):
            _draw_masks(panel, best, name)
            panel.set_title(title_text(best, told, remark_parts(best)), fontsize=10)
            panel.set_xlim(0, 1.03 * max(run.last_steps for run in best))
            label_steps(panel)
            label_success(panel, f"{kind} success of masked goal")
    return figure


def best_setting(runs: Sequence[TrainedRun]) -> list[TrainedRun]:
    """Of runs of several settings, those of the one with most success over all of training.

    Raises:
        ValueError: runs differ in what no row tells.
    """
    horizon = max(run.last_steps for run in runs)
    return max(by_settings(runs), key=lambda same: mean_success(same, horizon))


def mask_label(mask: int, size: int) -> str:
    """The kept dimensions of a mask, such as "x z" for 5 of 8; of other sizes by number, from 0."""
    names = AXES if size == len(AXES) else [str(i) for i in range(size)]
    kept = [names[i] for i in range(size) if mask >> (size - 1 - i) & 1]
    return " ".join(kept) or "none"


def shown_masks(size: int) -> list[int]:
    """Of all masks of goals with `size` dimensions those to show.

    All, or where these are many, those of one dimension and the full goal.
    """
    if 2**size <= ALL_MASKS:
        return list(range(2**size))
    return [*(1 << i for i in reversed(range(size))), 2**size - 1]


def _draws_masks(run: TrainedRun) -> bool:
    """Whether there is an estimate, or a training success of another mask than the full one."""

    def known(row: Row) -> bool:
        estimated, training = (row.get(name) or [] for name, _ in KINDS)
        return any(rate is not None for rate in [*estimated, *training[:-1]])

    return any(map(known, run.rows))


def _draw_masks(panel: Axes, runs: Sequence[TrainedRun], name: str) -> None:
    rows = [row for row in rows_while_all_ran(runs) if row.get(name)]
    if not any(rate is not None for row in rows for rate in row[name]):
        say_empty(panel, "no value while all runs trained")
        return
    masks = len(rows[0][name])
    size = masks.bit_length() - 1
    shown, title = shown_masks(size), "kept dimensions"
    if len(shown) < masks:
        title += f"\n({len(shown)} of {masks:,} masks)"
    colours = matplotlib.colormaps["turbo"](np.linspace(0.05, 0.95, len(shown)))
    for mask, colour in zip(shown, colours, strict=True):
        steps, curves = curves_of(rows, lambda row, mask=mask: row[name][mask])
        if np.isfinite(curves).any():
            draw_quartiles(panel, steps, curves, mask_label(mask, size), colour)
    add_legend(panel, title=title)
