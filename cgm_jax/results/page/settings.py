"""Settings in which the runs of a page differ, and what the page calls them and their values."""

import json
from collections.abc import Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cgm_jax.config.named import is_own
from cgm_jax.results.figures.layout import order
from cgm_jax.results.figures.runs import NO_VALUE, TrainedRun, differing
from cgm_jax.results.page.sweeps import Sweep, is_finite, labels_of

SWEEP = "sweep"
"""Which directory a run is of, as if that were a setting of it."""

NOT_SETTINGS = ("name", "seed")
NOT_THERE = "-"

TITLES = {"c_g": "c_g", "kappa": "κ", "her": "HER", "env": "environment"}
CURRICULA = {"cgm": "CGM", "full": "full goals"}


@dataclass(frozen=True)
class Distinction:
    """A setting in which runs differ.

    Attributes:
        name: as options call it.
        values: its values, in order.
        between: whether only sweeps differ in it, so that naming the sweep tells it as well.
    """

    name: str
    values: Sequence[Hashable]
    between: bool

    def to_plain(self) -> dict[str, Any]:
        """As the page reads it."""
        texts = value_texts(self.name, self.values)
        scale = 100 if self.name == "c_g" else 1
        numbers = all(is_finite(value) and is_finite(scale * value) for value in self.values)
        return {
            "name": self.name,
            "title": title_of(self.name),
            "between": self.between,
            "unit": "%" if self.name == "c_g" else "",
            "values": [
                {
                    "text": text,
                    "label": label_of(self.name, text),
                    "number": scale * value if numbers else None,  # pyright: ignore
                }
                for value, text in zip(self.values, texts, strict=True)
            ],
        }


@dataclass(frozen=True)
class PageRun:
    """A run with the values of all distinctions; None where it does not have the setting."""

    sweep: int
    trained: TrainedRun
    settings: Mapping[str, Hashable]


def runs_with_settings(sweeps: Sequence[Sweep]) -> tuple[list[PageRun], list[Distinction]]:
    """All runs, and the settings that tell them apart, their seeds aside.

    Within a sweep these are those that its rows tell; between sweeps, all that their configs do.
    """
    labels = labels_of([sweep.path for sweep in sweeps])
    within = _unique(name for sweep in sweeps for name in _names_within(sweep))
    between = [name for name in _names_between(sweeps) if name not in within]
    several = len(sweeps) > 1
    runs = []
    for index, sweep in enumerate(sweeps):
        planned = sweep.planned
        for run in sweep.runs:
            values = planned.get(run.name, {})
            settings = {name: _value(run, values, name) for name in (*within, *between)}
            runs.append(PageRun(index, run, settings | {SWEEP: labels[index]}))
    names = [*within, *([SWEEP] if several else []), *between]
    found = [Distinction(name, _values_of(runs, name), name in between) for name in names]
    return runs, [one for one in found if len(one.values) > 1]


def differences(sweeps: Sequence[Sweep]) -> tuple[list[dict[str, Any]], list[list[str]]]:
    """What differs between sweeps, or within one, by their configs; and what all have in common.

    Returns:
        Per setting that differs its title and what each sweep has, and title and value of others.
    """
    table = [_texts_of(sweep) for sweep in sweeps]
    differ, common = [], []
    for name in _unique(name for column in table for name in column):
        texts = [column.get(name, [NOT_THERE]) for column in table]
        if all(text == texts[0] for text in texts) and len(texts[0]) == 1:
            common.append([title_of(name), texts[0][0]])
        else:
            differ.append({"title": title_of(name), "values": [", ".join(text) for text in texts]})
    return differ, common


def title_of(name: str) -> str:
    """What a setting is called."""
    return TITLES.get(name, name.replace("_", " "))


def value_texts(name: str, values: Sequence[Hashable]) -> list[str]:
    """Values as text, short where that still tells them apart."""
    short = [_text(name, value) for value in values]
    return short if len({*short}) == len(short) else [_whole(value) for value in values]


def label_of(name: str, text: str) -> str:
    """A setting and its value together."""
    return text if name in ("env", "agent", "curriculum", SWEEP) else f"{title_of(name)} {text}"


def _text(name: str, value: Any) -> str:
    if isinstance(value, bool):
        return "on" if value else "off"
    if is_finite(value):
        is_share = name == "c_g" and is_finite(100 * value)
        return f"{100 * value:.10g} %" if is_share else f"{value:.10g}"
    if name == "curriculum":
        value = CURRICULA.get(value, value)
    if name == "agent" and isinstance(value, str) and not is_own(value):
        value = value.upper()
    if isinstance(value, str) and ".py:" in value:
        file, _, attribute = value.rpartition(":")
        return f"{Path(file).name}:{attribute}"
    return _whole(value)


def _whole(value: Any) -> str:
    if isinstance(value, tuple):
        return "×".join(_whole(item) for item in value)  # noqa: RUF001 -- widths of layers
    return NO_VALUE if value is None else str(value)


def _names_within(sweep: Sweep) -> list[str]:
    """Settings in which runs of one sweep differ, by their rows or else by its config."""
    names = differing(sweep.runs)
    if sweep.told is None:
        planned = sweep.planned.values()
        candidates = _unique(name for values in planned for name in values)
        names += [
            name
            for name in candidates
            if name not in (*NOT_SETTINGS, "cgm")
            and len({json.dumps(values[name]) for values in planned if name in values}) > 1
        ]
    return _unique(names)


def _names_between(sweeps: Sequence[Sweep]) -> list[str]:
    """Settings of which two sweeps have different values."""
    if len(sweeps) < 2:
        return []
    columns = [_values_by_name(sweep) for sweep in sweeps]
    names = _unique(name for column in columns for name in column)
    return [name for name in names if len({json.dumps(one.get(name)) for one in columns}) > 1]


def _values_by_name(sweep: Sweep) -> dict[str, list[Any]]:
    """By setting, the values that runs of a sweep were to have, in order."""
    found: dict[str, set[Hashable]] = {}
    for values in sweep.planned.values():
        for name in values.keys() - {*NOT_SETTINGS}:
            found.setdefault(name, set()).add(_hashable(values[name]))
    return {name: sorted(found[name], key=order) for name in sorted(found)}


def _texts_of(sweep: Sweep) -> dict[str, list[str]]:
    """What a sweep's config says of itself: how it was begun, and its settings."""
    facts = {name: sweep.config.get(name) for name in ("preset", "commit", "device", "machine")}
    versions = sweep.config.get("versions")
    if isinstance(versions, dict):
        facts |= {f"{name} version": version for name, version in versions.items()}
    texts = {name: [str(fact)] for name, fact in facts.items() if fact is not None}
    for name, values in _values_by_name(sweep).items():
        texts[name] = value_texts(name, values)
    return texts


def _value(run: TrainedRun, planned: Mapping[str, Any], name: str) -> Hashable:
    """A run's value of a setting: by its rows, or by the config where they do not tell it."""
    if name in run.settings:
        return run.settings[name]
    if name not in planned:
        return None
    value = _hashable(planned[name])
    return NO_VALUE if value is None else value


def _values_of(runs: Sequence[PageRun], name: str) -> list[Hashable]:
    return sorted({run.settings[name] for run in runs} - {None}, key=order)


def _hashable(value: Any) -> Hashable:
    if isinstance(value, list):
        return tuple(_hashable(item) for item in value)
    return json.dumps(value) if isinstance(value, dict) else value


def _unique(names: Iterable[str]) -> list[str]:
    return list(dict.fromkeys(names))
