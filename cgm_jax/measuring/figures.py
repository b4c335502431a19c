"""A measured figure, and how functions are timed in turn."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np


@dataclass(frozen=True)
class Figure:
    """One measured figure; `low` or `high` is the bound that it should keep."""

    name: str
    value: float
    unit: str
    low: float | None = None
    high: float | None = None

    def row(self) -> tuple[str, str, str]:
        """Name, value and bound as text."""
        bound = f"at least {self.low:g}" if self.low is not None else ""
        bound = f"at most {self.high:g}" if self.high is not None else bound
        return self.name, f"{self.value:.3g} {self.unit}".strip(), bound


def seconds(function: Callable[[], Any]) -> float:
    """Wall seconds that a call takes."""
    began = time.perf_counter()
    function()
    return time.perf_counter() - began


def medians(functions: Sequence[Callable[[], Any]], repeats: int) -> list[float]:
    """Median seconds of each function, measured in turn after one warm-up each."""
    for function in functions:
        function()
    rounds = [[seconds(function) for function in functions] for _ in range(repeats)]
    return [float(median) for median in np.median(rounds, axis=0)]
