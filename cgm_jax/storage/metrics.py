"""Rows of metrics: dicts in memory, one line of JSON each in a file, or one of a table."""

import csv
import io
import json
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from cgm_jax.config.spelling import spelled
from cgm_jax.storage.untrusted import from_json

Row = dict[str, Any]
"""What metrics.jsonl says of one run and epoch, in plain values as JSON has them."""

ENTRIES: dict[str, Any] = {
    "run": str,
    "epoch": int,
    "success_rate": int | float | None,
    "physics_warnings": int | float,
    "failed_epoch": int | None,
    "failure": str | None,
}
"""What a summary reads of a row, and of what types."""

PRINTED = ("run", "failure")
"""What a summary shows in a terminal, which texts can do things to."""

FORMULA = ("=", "+", "-", "@", "\t", "\r")
"""How a text begins that a spreadsheet takes for a formula."""


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
    rows = [from_json(line) for line in lines]
    if not all(isinstance(row, dict) for row in rows):
        raise ValueError("a line is no object")
    return rows


def check_row(row: Row, entries: Mapping[str, Any] = ENTRIES) -> None:
    """Check what is read of a row, which may come from anybody.

    Args:
        row: of a run and epoch.
        entries: what is read of it, and of what types; by default what a summary does.

    Raises:
        ValueError, KeyError: it is not such as a sweep writes.
    """
    for name, kinds in entries.items():
        value = row[name]
        if not isinstance(value, kinds) or isinstance(value, bool):
            raise ValueError(f"{name}: {value!r:.40} in a row")
        missing = isinstance(value, float) and not math.isfinite(value)  # as good as null
        unprintable = name in PRINTED and not str(value).isprintable()
        if unprintable or (missing and not isinstance(None, kinds)):
            raise ValueError(f"{name}: {value!r:.40} in a row")
    for name in ("swept", "reported"):
        words = row.get(name, [])
        if not isinstance(words, list) or not all(isinstance(word, str) for word in words):
            raise ValueError(f"{name}: {words!r:.40} in a row")


def check_rows(rows: Sequence[Row], names: Sequence[str], epochs: int) -> None:
    """Check that rows are those of a group's runs, of all epochs, in order.

    Args:
        rows: which may come from anybody.
        names: of the runs.
        epochs: that they have done.

    Raises:
        ValueError, KeyError: they are not.
    """
    for row in rows:
        check_row(row)
    if len(rows) == epochs * len(names):  # or else there might be no end to what is expected
        expected = [(name, epoch) for epoch in range(1, epochs + 1) for name in names]
        if [(row["run"], row["epoch"]) for row in rows] == expected:
            return
    raise ValueError("there is not one row per run and epoch")


def to_csv(rows: Sequence[Row]) -> str:
    """Rows as a table for spreadsheets, R and the like; what is null is an empty cell.

    A list has a column per entry, such as `mask_probability_7`; one that is a swept setting (hidden
    layers) is one word, such as 64x64. Lists of names (`swept`, `reported`) are one word as well. A
    text that a spreadsheet would take for a formula has an apostrophe before it.
    """
    tables = [dict(_cells(row)) for row in rows]
    columns = list(dict.fromkeys(name for cells in tables for name in cells))
    # What is a list in some rows and null in others has the columns of the list only.
    spread = {name for row, cells in zip(rows, tables, strict=True) for name in row.keys() - cells}
    columns = [name for name in columns if name not in spread]
    text = io.StringIO()
    writer = csv.DictWriter(text, columns, extrasaction="ignore", lineterminator="\n")
    writer.writeheader()
    writer.writerows(tables)
    return text.getvalue()


def _cells(row: Row) -> Iterator[tuple[str, Any]]:
    for name, value in row.items():
        if isinstance(value, str):
            yield name, f"'{value}" if value.startswith(FORMULA) else value
        elif not isinstance(value, list):
            yield name, value
        elif name in row.get("swept", ()):
            yield name, spelled(value)
        elif name in ("swept", "reported"):
            yield name, " ".join(value)
        else:
            yield from _entries(name, value)


def _entries(name: str, value: Any) -> Iterator[tuple[str, Any]]:
    """The numbers in a list, or in lists of lists, under the names of their columns."""
    if not isinstance(value, list):
        yield name, value
        return
    for index, entry in enumerate(value):
        yield from _entries(f"{name}_{index}", entry)


def _seven_digits(value: float) -> float:
    return float(f"{value:.7g}")


def _plain(value: Any) -> Any:
    """Arrays to lists and numbers, NaN and infinities to None."""
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, np.ndarray | np.generic):
        array = np.asarray(value)
        if np.issubdtype(array.dtype, np.floating):  # float32 has seven digits
            return _plain(np.vectorize(_seven_digits, otypes=[float])(array).tolist())
        return _plain(array.tolist())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
