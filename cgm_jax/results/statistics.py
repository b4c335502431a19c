"""Small statistics of success rates and learning curves."""

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


def have_finished(
    rates: Sequence[float | None], runs: int, epoch: int, epochs: int, leave_at: float | None
) -> bool:
    """Whether runs that train side by side are done after a whole epoch.

    Args:
        rates: success of each run in each epoch so far, those of an epoch together.
        runs: how many they are.
        epoch: whole epochs done.
        epochs: how many they train at most.
        leave_at: success that all of them hold when they leave early; None if they do not.
    """
    if leave_at is None or not 0 < epoch < epochs:
        return epoch >= epochs
    last = rates[-HOLDING_EVALUATIONS * runs :]
    return all(holds(last[i::runs], leave_at) for i in range(runs))


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


def wilson_interval(successes: int, trials: int) -> tuple[float, float]:
    """95 % confidence interval of a success rate (Wilson 1927).

    Raises:
        ValueError: no trials.
    """
    from scipy.stats import binomtest  # takes a moment, and only evaluation needs it

    if trials < 1:
        raise ValueError("a success rate needs at least one trial")
    interval = binomtest(successes, trials).proportion_ci(0.95, "wilson")
    return float(interval.low), float(interval.high)
