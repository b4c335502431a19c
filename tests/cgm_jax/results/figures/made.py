"""Rows of metrics.jsonl, made up, and what is read back from figures."""

import itertools
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.legend import Legend
from matplotlib.lines import Line2D

STEPS = 1000
"""Environment steps of an epoch."""

SETTINGS = {"env": "reach", "curriculum": "cgm", "agent": "ddpg", "c_g": 0.1, "kappa": 32.0}
MASKED = ("mask_rate_estimated", "mask_rate_training")

Rates = Sequence[float | None]


def run(rates: Rates, seed: int = 0, swept: Sequence[str] = (), **values: Any) -> list[Any]:
    """The rows of one run with this success, as the recorder writes them.

    Further values are settings, or metrics: per epoch where they can be called.
    """
    settings = {**SETTINGS, "her": True, **values}
    if settings["curriculum"] != "cgm":
        settings |= {"c_g": None, "kappa": None}
    name = "_".join(f"{value}" for value in settings.values() if not callable(value))
    return [
        {
            "run": f"{name}_seed{seed}",
            "seed": seed,
            "cgm": settings["curriculum"] == "cgm",
            "swept": list(swept),
            "epoch": epoch,
            "env_steps": STEPS * epoch,
            "success_rate": rate,
            "failed_epoch": None,
            "failure": None,
            "reported": [],
            **dict.fromkeys(MASKED),
            **{key: value(epoch) if callable(value) else value for key, value in settings.items()},
        }
        for epoch, rate in enumerate(rates, start=1)
    ]


def sweep(
    rates: Callable[..., Rates], seeds: int = 2, shared: dict[str, Any] | None = None, **axes: Any
) -> list[Any]:
    """The rows of all combinations; `rates` takes the settings of one by name, and its seed."""
    rows = []
    for values in itertools.product(*axes.values()):
        settings = dict(zip(axes, values, strict=True))
        for seed in range(seeds):
            own = {**settings, **(shared or {})}
            rows += run(rates(**settings, seed=seed), seed, list(axes), **own)
    return rows


def panels(figure: Figure) -> list[Axes]:
    """The panels of a figure, drawn once: what cannot be drawn raises. Without colour bars."""
    figure.canvas.draw()
    return [axes for axes in figure.axes if axes.get_label() != "<colorbar>"]


def titles(figure: Figure) -> list[str]:
    """The titles of all panels, each in one line."""
    return [axes.get_title().replace("\n", " ") for axes in panels(figure)]


def legend_of(panel: Axes) -> Legend:
    """A panel's legend."""
    shown = panel.get_legend()
    assert shown is not None
    return shown


def legend(panel: Axes) -> list[str]:
    """The entries of a panel's legend; none if it has none."""
    return [text.get_text() for text in legend_of(panel).get_texts()] if panel.get_legend() else []


def line(panel: Axes, label: str) -> Line2D:
    """The one line with this label."""
    (found,) = [one for one in panel.get_lines() if one.get_label() == label]
    return found


def points(panel: Axes, label: str) -> np.ndarray:
    """Its points, [points, 2]."""
    return np.array(line(panel, label).get_xydata(), float)


def heights(panel: Axes, label: str) -> list[float]:
    """Their heights."""
    return points(panel, label)[:, 1].tolist()
