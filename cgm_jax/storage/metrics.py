"""Rows of metrics: dicts in memory, one line of JSON each in a file."""

import json
import math
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

Row = dict[str, Any]
"""What metrics.jsonl says of one run and epoch, in plain values as JSON has them."""


def plain_row(values: Mapping[str, Any]) -> Row:
    """A row from any values: arrays become lists, a number that does not exist (0 / 0) None."""
    return {name: _plain(value) for name, value in values.items()}


def to_lines(rows: Iterable[Row]) -> str:
    """Rows as text, one line each."""
    return "".join(json.dumps(row) + "\n" for row in rows)


def from_lines(lines: Iterable[str]) -> list[Row]:
    """Rows from lines of text.

    Raises:
        ValueError: a line is no JSON object.
        RecursionError: a line nests too deep.
    """
    rows = [json.loads(line) for line in lines]
    if not all(isinstance(row, dict) for row in rows):
        raise ValueError("a line is no object")
    return rows


def _plain(value: Any) -> Any:
    """Arrays to lists and numbers, NaN and infinities to None."""
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, np.ndarray | np.generic):
        array = np.asarray(value)
        if np.issubdtype(array.dtype, np.floating):  # float32 has seven digits
            array = array.astype(np.float64).round(7)
        return _plain(array.tolist())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
