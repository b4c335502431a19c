"""The ratio of two costs from pairs of measurements, with its confidence interval."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats

CONFIDENCE = 0.95


@dataclass(frozen=True)
class Ratio:
    """A ratio with its confidence interval from `low` to `high`."""

    value: float
    low: float
    high: float

    def verdict(self, bound: float) -> str:
        """Whether the ratio is at most `bound`, as far as the interval decides it."""
        if self.high <= bound:
            return "kept"
        return "missed" if self.low > bound else "open"


def paired_ratio(ones: Sequence[float], others: Sequence[float]) -> Ratio:
    """Geometric mean of one / other over pairs, and Student's interval of its logarithm.

    Noise multiplies a time rather than adding to it, and the two of a pair share most of it; so
    the logarithms of the pairs' ratios are taken as independent and normal.

    Args:
        ones: a cost for each pair, above 0.
        others: the other cost of each pair, above 0.

    Raises:
        ValueError: fewer than two pairs, not as many of one as of the other, or a cost that is
            not above 0.
    """
    if len(ones) != len(others) or len(ones) < 2:
        raise ValueError("an interval needs at least two pairs")
    if min(*ones, *others) <= 0:
        raise ValueError("a ratio needs costs above 0")
    logarithms = np.log(ones) - np.log(others)
    mean, error = logarithms.mean(), stats.sem(logarithms)
    half_width = stats.t.ppf((1 + CONFIDENCE) / 2, len(ones) - 1) * error
    value, low, high = np.exp([mean, mean - half_width, mean + half_width])
    return Ratio(float(value), float(low), float(high))
