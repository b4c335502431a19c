"""JSON that may come from anybody: how deep it may nest, and what reading its values raises."""

import json
from typing import Any

UNREADABLE = (
    *(KeyError, IndexError, TypeError, AttributeError),
    *(ValueError, OverflowError, RecursionError),
)
"""What is raised by reading a file whose values are of other types than they should be, besides
OSError."""

MAX_DEPTH = 100
"""Of lists and objects within each other; ours have less than ten."""


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
