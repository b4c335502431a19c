"""Small statistics of success rates and learning curves, in plain Python."""

import math
from collections.abc import Sequence
from typing import Any

HOLDING_EVALUATIONS = 3
"""A run holds a success if the mean of so many evaluations in a row does."""


def holds(rates: Sequence[float | None], level: float) -> bool:
    """Whether the last evaluations of one run, taken together, reach `level`."""
    last = [rate or 0.0 for rate in rates[-HOLDING_EVALUATIONS:]]
    return len(last) == HOLDING_EVALUATIONS and sum(last) / len(last) >= level


def quartiles(values: Sequence[float]) -> tuple[float, float, float]:
    """Lower quartile, median and upper quartile of when runs got somewhere.

    Each is one of the values, between two of them the later, so that one between a run that
    arrived and one that never did (infinity) never did.
    """
    ordered, last = sorted(values), len(values) - 1
    low, median, high = (ordered[math.ceil(share * last)] for share in (0.25, 0.5, 0.75))
    return low, median, high


def wilson_interval(successes: int, trials: int, z: float = 1.96) -> tuple[float, float]:
    """Confidence interval of a success rate (Wilson 1927); z = 1.96 for 95 %.

    Raises:
        ValueError: no trials.
    """
    if trials < 1:
        raise ValueError("a success rate needs at least one trial")
    rate = successes / trials
    centre = (rate + z * z / (2 * trials)) / (1 + z * z / trials)
    spread = math.sqrt(rate * (1 - rate) / trials + (z / (2 * trials)) ** 2)
    spread *= z / (1 + z * z / trials)
    return max(0.0, centre - spread), min(1.0, centre + spread)


def first_to_reach(rows: Sequence[dict[str, Any]], level: float) -> dict[str, Any] | None:
    """The first metrics row of one run whose success rate is at least `level`."""
    return next((row for row in rows if (row["success_rate"] or 0.0) >= level), None)
