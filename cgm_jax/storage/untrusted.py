"""What may come from anybody: JSON, how large and deep it may be; and text for a terminal."""

import json
import stat
from pathlib import Path
from typing import Any

UNREADABLE = (
    *(KeyError, IndexError, TypeError, AttributeError),
    *(ValueError, OverflowError, RecursionError),
)
"""What is raised by reading a file whose values are of other types than they should be, besides
OSError."""

MAX_CONFIG_BYTES = 2**28
"""Of a config.json with as many runs as a sweep may have."""

MAX_DEPTH = 100
"""Of lists and objects within each other; ours have less than ten."""


def printable(text: str) -> str:
    """A text from anybody as a terminal may be given it: whatever is no letter is "?"."""
    return "".join(letter if letter.isprintable() else "?" for letter in text)


def read_json(path: Path, most_bytes: int) -> Any:
    """The value that a file holds.

    Raises:
        OSError: it cannot be read.
        ValueError: it is no ordinary file, has more bytes than that, or is no JSON.
        RecursionError: it nests too deep.
    """
    status = path.stat()
    if not stat.S_ISREG(status.st_mode):  # to read a pipe may take forever
        raise ValueError("it is no ordinary file")
    if status.st_size > most_bytes:
        raise ValueError(f"it has more than {most_bytes:,} bytes")
    return from_json(path.read_bytes())


def from_json(text: str | bytes) -> Any:
    """The value that a text holds, which nests at most `MAX_DEPTH` deep.

    Raises:
        ValueError: it is no JSON.
        RecursionError: it nests too deep.
    """
    value = json.loads(text)
    level, depth = _nested([value]), 0  # without recursion, which there may be too much of
    while level:
        if (depth := depth + 1) > MAX_DEPTH:
            raise RecursionError(f"more than {MAX_DEPTH} lists and objects within each other")
        level = [inner for outer in level for inner in _nested(outer)]
    return value


def _nested(values: Any) -> list[Any]:
    """The lists and objects within a list or an object."""
    values = values.values() if isinstance(values, dict) else values
    return [value for value in values if isinstance(value, list | dict)]
