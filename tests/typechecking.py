"""What jaxtyping's import hook checks in tests: shapes and types at every call of a function."""

from collections.abc import Callable
from typing import Any

from beartype import beartype


def check(function: Callable[..., Any]) -> Callable[..., Any]:
    """Check a function's annotations at its calls.

    Not those of a class of arrays when it is made: JAX makes them of shapes, of axes and of nothing
    on its way through a pytree.
    """
    return function if function.__name__ == "__init__" else beartype(function)
