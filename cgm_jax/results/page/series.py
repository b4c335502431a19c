"""The metrics of one run as columns: numbers, and arrays of which a few rows are shown."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from cgm_jax.results.figures.labels import naming_array
from cgm_jax.results.figures.masks import ALL_MASKS, mask_label, shown_masks
from cgm_jax.results.figures.runs import ALWAYS, TrainedRun
from cgm_jax.results.page.sweeps import is_finite
from cgm_jax.storage.metrics import Row

AXES = ("epoch", "env_steps", "wall_s")
NO_MEASURES = {*AXES, *ALWAYS, "run", "seed", "cgm", "swept", "updates", "failed_epoch"}

MAX_ROWS = 32
"""Values of an array that are shown; of more, evenly spaced ones."""


def columns_of(run: TrainedRun) -> dict[str, list[float | None]]:
    """By name, a number per epoch: where the epoch lies, and all that was measured in it.

    Success is there even where it never was, which the page counts as none.
    """
    swept = {name for row in run.rows for name in row.get("swept") or ()}
    names = _names(run.rows, is_finite)
    measures = [name for name in names if name not in NO_MEASURES | swept]
    columns = dict.fromkeys((*AXES, "success_rate", *measures))
    return {name: [_number(row.get(name)) for row in run.rows] for name in columns}


def arrays_of(run: TrainedRun) -> dict[str, dict[str, Any]]:
    """By name, arrays that were measured: `labels` of the rows shown, `total` and `values`.

    `values` [rows, epochs] are numbers, or null where there was none.
    """
    swept = {name for row in run.rows for name in row.get("swept") or ()}
    names = _names(run.rows, lambda value: isinstance(value, list))
    arrays = {}
    for name in names:
        if name in NO_MEASURES | swept | {"reported"}:
            continue
        flat = [_flat(row.get(name)) for row in run.rows]
        if any(value is not None for values in flat for value in values):
            size = max(map(len, flat))
            shown = shown_rows(name, size)
            arrays[name] = {
                "labels": _labels(name, size, shown, run.rows[-1]),
                "total": size,
                "values": [[_at(values, i) for values in flat] for i in shown],
            }
    return arrays


def shown_rows(name: str, size: int) -> list[int]:
    """Which rows of an array are shown: of one value per mask `shown_masks`, else some evenly."""
    if is_by_mask(name, size) and size > ALL_MASKS:
        return shown_masks(size.bit_length() - 1)
    return np.unique(np.linspace(0, size - 1, min(size, MAX_ROWS)).round().astype(int)).tolist()


def is_by_mask(name: str, size: int) -> bool:
    """Whether an array has a value for every mask."""
    return name.startswith("mask_") and size == 1 << (size.bit_length() - 1)


def _labels(name: str, size: int, shown: Sequence[int], row: Row) -> list[str]:
    """What rows are called: masks by what they keep, goal dimensions alike, else by number from 0.

    An array `a_b` belongs to an array `a` of the same row, if there is one: its values name it.
    """
    if is_by_mask(name, size):
        return [mask_label(i, size.bit_length() - 1) for i in shown]
    if name == "subgoal_success":
        return [mask_label(1 << (size - 1 - i), size) for i in shown]
    naming = naming_array(name, size, row)
    if naming and all(map(is_finite, row[naming])):
        texts = [f"{row[naming][i]:.3g}" for i in shown]
        unique = len({*texts}) == len(texts)
        return texts if unique else [f"{i}: {text}" for i, text in zip(shown, texts, strict=True)]
    return [str(i) for i in shown]


def _names(rows: Sequence[Row], wanted: Any) -> list[str]:
    return list(dict.fromkeys(name for row in rows for name in row if wanted(row[name])))


def _flat(value: Any) -> list[float | None]:
    if not isinstance(value, list):
        return []
    if any(isinstance(item, list) for item in value):
        value = np.array(value, object).ravel().tolist()
    return [_number(item) for item in value]


def _at(values: Sequence[float | None], index: int) -> float | None:
    return values[index] if index < len(values) else None


def _number(value: Any) -> float | None:
    return value if is_finite(value) else None
