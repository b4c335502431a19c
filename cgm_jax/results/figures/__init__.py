"""Figures of a sweep, drawn from its metrics.jsonl alone.

curves.py      learning_curves.png: success over environment steps, median and quartiles over seeds
half.py        epochs_to_half.png: epochs until 50 % is held over c_g (the paper's Fig. 3)
masks.py       mask_success.png: estimated and training success per mask (the paper's Fig. 5)
curriculum.py  curriculum.png: what curricula report of themselves

runs.py        from rows to runs, and the settings in which they differ
layout.py      which runs share a panel and a line
labels.py      how settings are named
panels.py      panels, axes and legends
"""

import sys
from pathlib import Path

from matplotlib.figure import Figure

from cgm_jax.results.figures.curriculum import curriculum
from cgm_jax.results.figures.curves import draw_quartiles, learning_curves
from cgm_jax.results.figures.half import epochs_to_half
from cgm_jax.results.figures.masks import mask_label, mask_success
from cgm_jax.results.figures.panels import label_steps, label_success, make_panels
from cgm_jax.results.figures.runs import NothingToDraw, curves_of
from cgm_jax.storage.files import replacing
from cgm_jax.storage.run_directory import RunDirectory

__all__ = [
    "NothingToDraw",
    "curriculum",
    "curves_of",
    "draw_figures",
    "draw_quartiles",
    "epochs_to_half",
    "label_steps",
    "label_success",
    "learning_curves",
    "make_panels",
    "mask_label",
    "mask_success",
]

RESOLUTION = 130
"""Dots per inch."""

MAX_DOTS = 30_000
"""Dots of a figure's longer side, which matplotlib and viewers bear."""


def draw_figures(directory: RunDirectory) -> list[Path]:
    """Draw the figures of a sweep into its directory, each on its own.

    One that makes no sense for these runs is left out. One that would be looked for and has nothing
    to show, or that cannot be drawn, is a line on standard error.

    Returns:
        Paths of those that were drawn.

    Raises:
        OSError, ValueError: the metrics cannot be read.
    """
    rows = directory.metrics()
    if not rows:
        return []
    paths = []
    figures = {
        "learning_curves": learning_curves,
        "epochs_to_half": epochs_to_half,
        "mask_success": mask_success,
        "curriculum": curriculum,
    }
    for name, draw in figures.items():
        path = directory.path / "figures" / f"{name}.png"
        try:
            save_figure(draw(rows), path)
            paths.append(path)
        except NothingToDraw as reason:
            path.unlink(missing_ok=True)  # of an older version, which drew it in any case
            if reason.missed:
                print(f"{path.name} is not drawn: {reason}", file=sys.stderr)
        except Exception as error:  # what is wrong with one figure costs no other
            line = str(error).partition("\n")[0]
            print(f"{path} is not drawn: {type(error).__name__}: {line}", file=sys.stderr)
    return paths


def save_figure(figure: Figure, path: Path) -> None:
    """Write a figure as PNG.

    Raises:
        OSError: it cannot be written.
    """
    resolution = min(RESOLUTION, MAX_DOTS / max(figure.get_size_inches()))
    with replacing(path) as file:
        figure.savefig(file, dpi=resolution, format="png")
