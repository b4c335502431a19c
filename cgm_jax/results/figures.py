"""Figures of a sweep, drawn from its metrics.jsonl alone.

learning_curves.png   success rate over env_steps, median and quartiles over seeds
epochs_to_half.png    epochs until 50 % is held over c_g, one line per kappa (the paper's Fig. 3)
mask_success.png      estimated against training success per mask (the paper's Fig. 5)
"""

import math
import sys
from collections import defaultdict
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, MaxNLocator

from cgm_jax.results.statistics import first_to_hold, quartiles
from cgm_jax.storage.files import replacing
from cgm_jax.storage.run_directory import RunDirectory

Rows = list[dict[str, Any]]
QUARTILES = (25, 50, 75)


def draw_figures(directory: RunDirectory) -> list[Path]:
    """Draw all figures of a sweep into its directory, each on its own.

    One that cannot be drawn is a line on standard error.

    Returns:
        Paths of those that were drawn.

    Raises:
        OSError, ValueError: the metrics cannot be read.
    """
    rows = directory.metrics()
    if not rows:
        return []
    paths = []
    for draw in (learning_curves, epochs_to_half, mask_success):
        path = directory.path / "figures" / f"{draw.__name__}.png"
        try:
            figure = draw(rows)
            with replacing(path) as file:
                figure.savefig(file, dpi=130, format="png")
            paths.append(path)
        except Exception as error:
            line = str(error).partition("\n")[0]
            print(f"{path} is not drawn: {type(error).__name__}: {line}", file=sys.stderr)
    return paths


def learning_curves(rows: Rows) -> Figure:
    """Success rate over env_steps, a line per c_g; a panel per environment, HER and kappa.

    The runs without CGM, which have no kappa, appear in every panel in black. A cross marks
    where a run diverged; from there on its curve is that of its last sound policy.
    """
    groups = _grouped(
        rows, lambda row: (row["env"], row["her"], row["kappa"] if row["cgm"] else None)
    )
    plain = {key[:2]: same for key, same in groups.items() if key[2] is None}
    masked = {key: same for key, same in groups.items() if key[2] is not None} or groups
    figure, panels = make_panels(len(masked), width=5.0, height=4.0, columns=3)
    for panel, ((env, her, kappa), same) in zip(panels, sorted(masked.items()), strict=True):
        title = f"{_title(env)}, {'DDPG + HER' if her else 'DDPG'}"
        if kappa is not None:
            title += f", $\\kappa$ = {kappa:g}"
        if kappa is not None and (env, her) in plain:
            _draw_success(panel, plain[env, her], "no CGM", "black")
        by_rate = sorted(same, key=lambda row: (row["cgm"], row["c_g"]))
        lines = list(_grouped(by_rate, _line_label).items())
        colours = matplotlib.colormaps["viridis"](np.linspace(0.0, 0.9, len(lines)))
        for (label, runs), colour in zip(lines, colours, strict=True):
            _draw_success(panel, runs, label, colour)
        panel.axhline(0.5, color="grey", linewidth=0.8, linestyle=":")
        panel.set_title(title)
        label_steps(panel)
        label_success(panel, "success rate, full goal")
        panel.legend(fontsize=8, loc="lower right", framealpha=0.7)
    return figure


def epochs_to_half(rows: Rows) -> Figure:
    """Epochs to 50 % success over c_g, a panel per environment and HER, a line per kappa.

    A run is there once the mean of three evaluations holds 50 %. Medians over runs, and quartiles
    as dashed lines. Where a median run never gets there, its point is open and stands at the last
    epoch.
    """
    masked = [row for row in rows if row["cgm"]] or rows
    groups = _grouped(masked, lambda row: (row["env"], row["her"]))
    figure, panels = make_panels(len(groups), width=5.0, height=4.0)
    for panel, ((env, her), same) in zip(panels, groups.items(), strict=True):
        last = max(row["epoch"] for row in same)
        by_kappa = sorted(_grouped(same, lambda row: row["kappa"]).items())
        reached = [
            _draw_epochs_over_rate(panel, kappa, kappa_rows, last) for kappa, kappa_rows in by_kappa
        ]
        plain = [r for r in rows if not r["cgm"] and (r["env"], r["her"]) == (env, her)]
        if plain and same[0]["cgm"]:
            median = _epochs_to_half(plain)[1]
            label = "no CGM" if np.isfinite(median) else "no CGM (not reached)"
            panel.axhline(min(median, last), color="black", linestyle="-.", label=label)
        if not all(reached):
            _mark_last_epoch(panel, last)
        panel.set_title(f"{_title(env)}, {'DDPG + HER' if her else 'DDPG'}")
        panel.set_xlabel("target success rate $c_g$ (%)")
        panel.set_ylabel("epochs to 50 % success")
        steps = same[0]["env_steps"] // same[0]["epoch"]
        panel.annotate(
            f"an epoch: {steps:,} env_steps",
            (0.98, 0.02),
            xycoords="axes fraction",
            horizontalalignment="right",
            fontsize=8,
            color="grey",
        )
        panel.set_ylim(0, last * 1.12)
        panel.yaxis.set_major_locator(MaxNLocator(integer=True))
        panel.legend(fontsize=8)
    return figure


def mask_success(rows: Rows) -> Figure:
    """Estimated and training success per mask, for the best setting with CGM per environment."""
    by_env = _grouped([row for row in rows if row["cgm"]] or rows, lambda row: row["env"])
    figure, panels = make_panels(2 * len(by_env), width=5.0, height=4.0, columns=2)
    pairs = zip(panels[::2], panels[1::2], strict=True)
    for (estimated, training), (env, env_rows) in zip(pairs, by_env.items(), strict=True):
        label, best = max(
            _grouped(env_rows, _setting_label).items(),
            key=lambda entry: np.mean([row["success_rate"] or 0.0 for row in entry[1]]),
        )
        for panel, name in ((estimated, "mask_rate_estimated"), (training, "mask_rate_training")):
            _draw_masks(panel, best, name)
            panel.set_title(f"{_title(env)}, {label}", fontsize=10)
            label_steps(panel)
        label_success(estimated, "estimated success of masked goal")
        label_success(training, "training success of masked goal")
        training.legend(title="kept axes", fontsize=8, title_fontsize=8, loc="center right")
    return figure


def _draw_success(panel: Axes, rows: Rows, label: str, colour: Any) -> None:
    """One line of learning curves, with a cross for every run that diverged."""
    failed = _failures(rows)
    draw_quartiles(panel, *curves_of(rows, "success_rate"), label + _diverged(failed), colour)
    for row in failed:
        panel.plot(row["env_steps"], row["success_rate"] or 0.0, "x", color=colour, zorder=4)


def _failures(rows: Rows) -> Rows:
    """Of every run that diverged, the row of the epoch in which it did."""
    return [row for row in rows if row.get("failed_epoch") == row["epoch"]]


def _diverged(failed: Rows) -> str:
    return f" ({len(failed)} diverged)" if failed else ""


def _mark_last_epoch(panel: Axes, last: int) -> None:
    panel.axhline(last, color="grey", linewidth=0.8, linestyle=":")
    panel.annotate(
        f"not within {last} epochs (open)",
        (0.02, last),
        xycoords=("axes fraction", "data"),
        xytext=(0, 3),
        textcoords="offset points",
        fontsize=8,
        color="grey",
    )


def _draw_epochs_over_rate(panel: Axes, kappa: float, rows: Rows, last: int) -> bool:
    """One line: quartiles over runs, at each c_g, of the epoch that first holds 50 %.

    Returns:
        Whether all medians reach it.
    """
    points = []
    for c_g, same in sorted(_grouped(rows, lambda row: row["c_g"]).items()):
        quartiles = _epochs_to_half(same)
        points.append((100 * c_g, *np.minimum(quartiles, last), np.isinf(quartiles[1])))
    rates, low, median, high, unreached = np.array(points).T
    unreached = unreached.astype(bool)
    label = f"$\\kappa$ = {kappa:g}{_diverged(_failures(rows))}"
    (line,) = panel.plot(rates, median, label=label, zorder=3)
    colour = line.get_color()
    panel.plot(rates[~unreached], median[~unreached], "o", color=colour, zorder=4)
    panel.plot(rates[unreached], median[unreached], "o", color=colour, mfc="white", zorder=4)
    if len(rows) > len({(row["c_g"], row["epoch"]) for row in rows}):
        panel.plot(rates, low, linestyle="--", linewidth=0.8, color=colour)
        panel.plot(rates, high, linestyle="--", linewidth=0.8, color=colour)
    return not unreached.any()


def _epochs_to_half(rows: Rows) -> tuple[float, float, float]:
    """Quartiles over runs of the first epoch that holds 50 %; infinite where none does."""
    reached = [first_to_hold(run, 0.5) for run in _grouped(rows, lambda r: r["run"]).values()]
    return quartiles([row["epoch"] if row else math.inf for row in reached])


def _draw_masks(panel: Axes, rows: Rows, name: str) -> None:
    masks = len(rows[0][name])
    size = masks.bit_length() - 1
    colours = matplotlib.colormaps["turbo"](np.linspace(0.05, 0.95, masks))
    few = [*(1 << i for i in range(size)), masks - 1]  # single dimensions and the full goal
    for mask in range(masks) if masks <= 16 else few:
        steps, curves = curves_of(rows, lambda row, mask=mask: row[name][mask])
        if not np.isfinite(curves).any():
            continue
        draw_quartiles(panel, steps, curves, mask_label(mask, size), colours[mask])


def mask_label(mask: int, size: int) -> str:
    """The kept dimensions of a mask, such as "x z" for 5 of 8."""
    names = "xyz" if size == 3 else [str(i + 1) for i in range(size)]
    kept = [names[i] for i in range(size) if mask >> (size - 1 - i) & 1]
    return " ".join(kept) or "none"


def draw_quartiles(
    panel: Axes,
    steps: np.ndarray,
    curves: np.ndarray,
    label: str,
    colour: Any = None,
    style: str = "-",
) -> None:
    """Median line and quartile band of curves [runs, epochs], where any run has a value."""
    known = np.isfinite(curves).any(axis=0)
    if not known.any():
        panel.plot([], [], style, label=f"{label} (no valid episode)", color=colour)
        return
    low, median, high = np.nanpercentile(curves[:, known], QUARTILES, axis=0)
    marker = "." if known.sum() < 2 else None
    (line,) = panel.plot(steps[known], median, style, label=label, color=colour, marker=marker)
    if len(curves) > 1:
        panel.fill_between(steps[known], low, high, color=line.get_color(), alpha=0.2, linewidth=0)


def curves_of(rows: Rows, value: Any) -> tuple[np.ndarray, np.ndarray]:
    """env_steps [epochs] and values [runs, epochs]; NaN where a run has no value."""
    read = value if callable(value) else lambda row: row[value]
    steps = sorted({row["env_steps"] for row in rows})
    place = {step: i for i, step in enumerate(steps)}
    runs = _grouped(rows, lambda row: row["run"])
    curves = np.full((len(runs), len(steps)), np.nan)
    for curve, run in zip(curves, runs.values(), strict=True):
        for row in run:
            number = read(row)
            curve[place[row["env_steps"]]] = np.nan if number is None else number
    return np.array(steps, float), curves


def _grouped(rows: Rows, key: Any) -> dict[Any, Rows]:
    groups: dict[Any, Rows] = defaultdict(list)
    for row in rows:
        groups[key(row)].append(row)
    return dict(groups)


def _setting_label(row: dict[str, Any]) -> str:
    """What the seeds of one setting have in common, for a title."""
    algorithm = "HER" if row["her"] else "DDPG"
    if not row["cgm"]:
        return ", ".join([f"{algorithm}, no CGM", *_other_axes(row)])
    return f"{algorithm} + CGM, {_line_label(row)}, $\\kappa$ = {row['kappa']:g}"


def _line_label(row: dict[str, Any]) -> str:
    """What tells a line of a panel from the others."""
    first = f"$c_g$ = {100 * row['c_g']:g} %" if row["cgm"] else "no CGM"
    return ", ".join([first, *_other_axes(row)])


def _other_axes(row: dict[str, Any]) -> list[str]:
    """Further swept settings, as the run's name has them."""
    tail = row["run"].rpartition("_her_" if row["her"] else "_ddpg_")[2]
    return tail.split("_")[1:-1]  # between the mask sampler and the seed


def make_panels(
    count: int, width: float, height: float, columns: int = 2
) -> tuple[Figure, list[Axes]]:
    """A figure with `count` panels of this size (inches), in rows of at most `columns`."""
    columns = min(columns, count)
    lines = -(-count // columns)
    # Not by pyplot, which would choose a backend for the whole process and keep the figure.
    figure = Figure(figsize=(width * columns, height * lines), layout="constrained")
    grid = figure.subplots(lines, columns, squeeze=False)
    panels = list(grid.flat)
    for unused in panels[count:]:
        unused.remove()
    for panel in panels[:count]:
        panel.grid(alpha=0.25)
    return figure, panels[:count]


def _title(env: str) -> str:
    return env.replace("_", "-") if ".py" not in env else Path(env).name


def label_steps(panel: Axes) -> None:
    """Name the horizontal axis env_steps, in thousands."""
    panel.set_xlabel("env_steps (thousands)")
    panel.xaxis.set_major_formatter(FuncFormatter(lambda step, _: f"{step / 1000:g}"))


def label_success(panel: Axes, label: str) -> None:
    """Make the vertical axis a success rate, in percent."""
    panel.set_ylabel(f"{label} (%)")
    panel.set_ylim(-0.03, 1.03)
    panel.yaxis.set_major_formatter(FuncFormatter(lambda rate, _: f"{100 * rate:.0f}"))
