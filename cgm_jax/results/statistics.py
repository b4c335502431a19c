"""Small statistics of success rates and learning curves, in plain Python."""

import math
from collections.abc import Sequence
from typing import Any

HOLDING_EVALUATIONS = 3
"""A run holds a success if the mean of so many evaluations in a row does."""

ROUNDING = 1e-9
"""Success rates are shares of whole episodes; their sums must not miss a level by rounding."""


def holds(rates: Sequence[float | None], level: float) -> bool:
    """Whether the last evaluations of one run, taken together, reach `level`."""
    last = [rate or 0.0 for rate in rates[-HOLDING_EVALUATIONS:]]
    return len(last) == HOLDING_EVALUATIONS and sum(last) / len(last) >= level - ROUNDING


def first_to_hold(rows: Sequence[dict[str, Any]], level: float) -> dict[str, Any] | None:
    """The first metrics row of one run at which it holds `level`: the last of three evaluations."""
    rates = [row["success_rate"] for row in rows]
    return next((row for i, row in enumerate(rows) if holds(rates[: i + 1], level)), None)


def quartiles(values: Sequence[float]) -> tuple[float, float, float]:
    """Lower quartile, median and upper quartile, interpolated linearly between values.

    A value of infinity is a run that never arrived. Whatever would be interpolated towards one is
    infinite: of two runs of which one arrived, the median never did.
    """
    ordered = sorted(values)

    def at(share: float) -> float:
        place = share * (len(ordered) - 1)
        below, above = ordered[math.floor(place)], ordered[math.ceil(place)]
        if below == above or math.isinf(above):
            return above
        return below + (place % 1) * (above - below)

    return at(0.25), at(0.5), at(0.75)


def median_interval(
    values: Sequence[float], confidence: float = 0.95
) -> tuple[float, float] | None:
    """Interval of the median from which independent values were drawn, whatever their distribution.

    From the k-th smallest to the k-th largest value, with the largest k such that the binomial
    chance to miss, 2 P(B < k) for B of n halves, is at most 1 - confidence (David and Nagaraja,
    Order Statistics, section 7.1). None where even the whole range does not suffice, which is so
    for fewer than six values at 95 %.
    """
    ordered, count = sorted(values), len(values)
    missed, best = 0.0, None
    for k in range(1, count // 2 + 1):
        missed += 2 * math.comb(count, k - 1) / 2**count
        if missed > 1 - confidence:
            break
        best = ordered[k - 1], ordered[-k]
    return best


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
