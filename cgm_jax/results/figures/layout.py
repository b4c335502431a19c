"""Which runs share a panel and a line, so that every setting that differs can be seen.

One setting gives lines their colours, further ones their styles; all others make panels. A setting
that only some runs have (c_g, kappa) does not set the others apart: a run without it appears in
every panel whose runs agree with it in all settings that both have.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import matplotlib
import numpy as np

from cgm_jax.results.figures.labels import line_text, title_text
from cgm_jax.results.figures.runs import ALWAYS, TrainedRun, differing, grouped

MAX_PANELS = 24
"""More than these would not be looked at: settings that would make more are told by lines."""

STYLES = ("-", "--", "-.", ":")

NO_CURRICULUM = "black"

CATEGORIES = (
    *("tab:blue", "tab:orange", "tab:green", "tab:red", "tab:purple"),
    *("tab:brown", "tab:pink", "tab:olive", "tab:cyan", "tab:gray"),
)

SPARE = ("tab:red", "tab:orange", "tab:pink", "tab:brown", "tab:gray")
"""Unlike all of the scale that values of a setting have."""

Values = tuple[Any, ...]


@dataclass(frozen=True)
class Line:
    """Runs that a line stands for, and how it looks.

    Attributes:
        label: what tells it from others; empty if there are none.
        colour: as matplotlib has it.
        style: likewise.
        runs: in order of appearance.
    """

    label: str
    colour: Any
    style: str
    runs: Sequence[TrainedRun]


@dataclass(frozen=True)
class Panel:
    """A title and lines, in the order of the legend."""

    title: str
    lines: Sequence[Line]

    @property
    def runs(self) -> list[TrainedRun]:
        """Those of all lines."""
        return [run for line in self.lines for run in line.runs]


def colour_setting(runs: Sequence[TrainedRun]) -> str | None:
    """The setting to tell by colours: c_g, the curriculum, or the one with most values."""
    names = [name for name in differing(runs) if name != "env"]
    for name in ("c_g", "curriculum"):
        if name in names:
            return name
    return max(names, key=lambda name: len({run.settings.get(name) for run in runs}), default=None)


def arrange(
    runs: Sequence[TrainedRun], colour: str | None, within: Sequence[str] = ()
) -> list[Panel]:
    """Spread runs over panels and lines.

    Args:
        runs: all of a figure.
        colour: the setting that colours tell, or None.
        within: settings in which the runs of one line may differ, the seed aside.
    """
    names = [name for name in differing(runs) if name not in within]
    on_lines = [name for name in dict.fromkeys((colour, "curriculum")) if name in names]
    parted = [name for name in names if name not in on_lines]
    while len(_panel_keys(runs, parted)) > MAX_PANELS:
        on_lines.append(parted.pop())
    looks = _looks(runs, colour, on_lines, pooled="curriculum" in within)
    told = [name for name in dict.fromkeys([*ALWAYS, *parted]) if name not in (*on_lines, *within)]
    panels = []
    for key in _panel_keys(runs, parted):
        own = [run for run in runs if _fits(_values(run, parted), key)]
        lines = sorted(grouped(own, lambda run: _values(run, on_lines)).items(), key=_line_order)
        panels.append(
            Panel(
                title_text(own, told),
                [Line(_label(same, runs, on_lines), *looks[key], same) for key, same in lines],
            )
        )
    return panels


def order(value: Any) -> tuple[int, Any]:
    """What to sort values by that may be of several types; those that are not there come last."""
    if value is None:
        return 3, 0
    if isinstance(value, bool | int | float):
        return 0, value
    return (1, tuple(map(order, value))) if isinstance(value, tuple) else (2, str(value))


def spread_colours(count: int) -> list[Any]:
    """So many colours of a scale, from dark to light."""
    return list(matplotlib.colormaps["viridis"](np.linspace(0.0, 0.9, count)))


def _values(run: TrainedRun, names: Sequence[str]) -> Values:
    return tuple(run.settings.get(name) for name in names)


def _line_order(line: tuple[Values, Sequence[TrainedRun]]) -> list[tuple[int, Any]]:
    return [order(value) for value in line[0]]


def _fits(values: Values, panel: Values) -> bool:
    """Whether a run agrees with a panel in all settings that it has."""
    return all(own is None or own == other for own, other in zip(values, panel, strict=True))


def _panel_keys(runs: Sequence[TrainedRun], names: Sequence[str]) -> list[Values]:
    """Values that panels stand for; runs with fewer settings than others join theirs."""
    keys = {_values(run, names) for run in runs}
    apart = [key for key in keys if not any(_fits(key, other) for other in keys - {key})]
    return sorted(apart, key=lambda key: [order(value) for value in key])


def _label(line: Sequence[TrainedRun], runs: Sequence[TrainedRun], names: Sequence[str]) -> str:
    """What tells a line from others: its settings, less a curriculum that the first one implies."""
    settings = line[0].settings
    told = list(names)
    if "curriculum" in told[1:] and settings.get(told[0]) is not None:
        having = [run for run in runs if run.settings.get(told[0]) is not None]
        if len({run.settings["curriculum"] for run in having}) == 1:
            told.remove("curriculum")
    return line_text(settings, told)


def _looks(
    runs: Sequence[TrainedRun], colour: str | None, on_lines: Sequence[str], *, pooled: bool
) -> dict[Values, tuple[Any, str]]:
    """Colour and style of every line, the same in all panels, by its values.

    Args:
        runs: all of a figure.
        colour: the setting that colours tell.
        on_lines: all settings that lines tell.
        pooled: whether runs of one line may differ in the curriculum.
    """
    keys = sorted(
        {_values(run, on_lines) for run in runs}, key=lambda key: [order(value) for value in key]
    )
    curriculum = {
        _values(run, on_lines): "" if pooled else str(run.settings.get("curriculum"))
        for run in runs
    }
    palette = {(None, ""): CATEGORIES[0], **_palette(runs, colour)}

    def basis(key: Values) -> tuple[Any, Any]:
        coloured = colour in on_lines and colour != "curriculum" and key[0] is not None
        return (key[0], None) if coloured else (None, curriculum[key])

    same_colour = grouped(keys, basis)
    looks = {}
    for shared, own in same_colour.items():
        for i, key in enumerate(own):
            looks[key] = palette[shared], STYLES[i % len(STYLES)]
    if max(map(len, same_colour.values())) > len(STYLES):  # too many for styles alone
        for (key, (_, style)), shade in zip(
            looks.items(), matplotlib.colormaps["turbo"](np.linspace(0, 1, len(keys))), strict=True
        ):
            looks[key] = shade, style
    return looks


def _palette(runs: Sequence[TrainedRun], colour: str | None) -> dict[tuple[Any, Any], Any]:
    """Colours by value of the colour's setting; by curriculum for runs without it."""
    palette: dict[tuple[Any, Any], Any] = {}
    if colour is not None and colour != "curriculum":
        values = sorted({run.settings.get(colour) for run in runs} - {None}, key=order)
        shades = spread_colours(len(values))
        palette = {(value, None): shade for value, shade in zip(values, shades, strict=True)}
    curricula = sorted({str(run.settings.get("curriculum")) for run in runs})
    several = len(curricula) > 1
    spare = SPARE if palette else CATEGORIES
    others = [name for name in curricula if not (several and name == "full")]
    palette |= {(None, name): spare[i % len(spare)] for i, name in enumerate(others)}
    if several:
        palette[None, "full"] = NO_CURRICULUM
    return palette
