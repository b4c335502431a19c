"""Panels of figures: how many, how large, their axes and legends.

Without pyplot, which would choose a backend for the whole process and keep every figure.
"""

from collections.abc import Sequence

from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter

MAX_INSIDE = 12
"""Entries of a legend that a panel has room for."""

MAX_ENTRIES = 60
"""Entries of a legend at all."""

ROWS = 22
"""Entries of one column beside a panel: as many as the tallest of Matplotlib's versions fits."""


def make_panels(
    count: int, width: float, height: float, columns: int = 2
) -> tuple[Figure, list[Axes]]:
    """A figure with `count` panels of this size (inches), in rows of at most `columns`."""
    columns = min(columns, count)
    lines = -(-count // columns)
    figure = Figure(figsize=(width * columns, height * lines), layout="constrained")
    FigureCanvasAgg(figure)
    panels = list(figure.subplots(lines, columns, squeeze=False).flat)
    for unused in panels[count:]:
        unused.remove()
    for panel in panels[:count]:
        panel.grid(alpha=0.25)
    return figure, panels[:count]


def legend_width(labels: Sequence[Sequence[str]]) -> float:
    """Inches that the widest legend of these panels takes beside its panel; 0 if all fit inside."""
    widths = [
        (0.5 + 0.065 * max(map(len, own))) * -(-min(len(own), MAX_ENTRIES) // ROWS)
        for own in labels
        if len(own) > MAX_INSIDE
    ]
    return max(widths, default=0.0)


def add_legend(panel: Axes, title: str | None = None) -> None:
    """A legend inside the panel, or beside it where it would hide too much.

    Of very many entries it shows the first ones, and says so.
    """
    handles, labels = panel.get_legend_handles_labels()
    if not handles:
        return
    if len(handles) <= MAX_INSIDE:
        panel.legend(
            handles, labels, loc="best", title=title, fontsize=8, title_fontsize=8, framealpha=0.7
        )
        return
    if left_out := len(handles) - MAX_ENTRIES if len(handles) > MAX_ENTRIES else 0:
        handles, labels = handles[:MAX_ENTRIES], labels[:MAX_ENTRIES]
        title = f"{title or ''} (and {left_out} more)".strip()
    panel.legend(
        handles,
        labels,
        loc="upper left",
        bbox_to_anchor=(1.01, 1.0),
        borderaxespad=0.0,
        labelspacing=0.2,
        ncols=-(-len(handles) // ROWS),
        title=title,
        fontsize=7,
        title_fontsize=7,
        frameon=False,
    )


def label_steps(panel: Axes) -> None:
    """Name the horizontal axis env_steps, in thousands."""
    panel.set_xlabel("env_steps (thousands)")
    panel.xaxis.set_major_formatter(FuncFormatter(lambda step, _: f"{step / 1000:g}"))


def label_success(panel: Axes, label: str) -> None:
    """Make the vertical axis a success rate, in percent."""
    panel.set_ylabel(f"{label} (%)")
    panel.set_ylim(-0.03, 1.03)
    panel.yaxis.set_major_formatter(FuncFormatter(lambda rate, _: f"{100 * rate:.0f}"))


def say_empty(panel: Axes, why: str) -> None:
    """Write into a panel why it is empty."""
    panel.grid(visible=False)
    panel.text(0.5, 0.5, why, transform=panel.transAxes, ha="center", va="center", color="grey")
