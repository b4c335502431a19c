import math

import numpy as np
import pytest

from cgm_jax.measuring.ratios import Ratio, paired_ratio


def test_two_pairs_by_hand() -> None:
    # Logarithms of the ratios are ln 2 and 3 ln 2: mean 2 ln 2, standard error ln 2. Student's
    # distribution with one degree of freedom is Cauchy's, whose quantile is a tangent.
    quantile = math.tan(math.pi * (0.975 - 0.5))
    ratio = paired_ratio([2.0, 24.0], [1.0, 3.0])
    assert ratio.value == pytest.approx(4.0)
    assert ratio.low == pytest.approx(4.0 / 2.0**quantile)
    assert ratio.high == pytest.approx(4.0 * 2.0**quantile)


def test_three_pairs_by_hand() -> None:
    # With two degrees of freedom the quantile of p solves t = (2 p - 1) sqrt(2 / (4 p (1 - p))).
    quantile = 0.95 * math.sqrt(2 / (4 * 0.975 * 0.025))
    ratio = paired_ratio([math.exp(0.1), math.exp(0.3), math.exp(-0.1)], [1.0, 1.0, 1.0])
    assert ratio.value == pytest.approx(math.exp(0.1))
    assert ratio.high == pytest.approx(math.exp(0.1 + quantile * 0.2 / math.sqrt(3)))


def test_sides_swapped_give_the_inverse() -> None:
    ones, others = [1.0, 1.2, 0.9], [1.1, 1.0, 1.3]
    ratio, inverse = paired_ratio(ones, others), paired_ratio(others, ones)
    assert ratio.value == pytest.approx(1 / inverse.value)
    assert ratio.low == pytest.approx(1 / inverse.high)


def test_what_strikes_both_of_a_pair_cancels() -> None:
    ratio = paired_ratio([1.02, 10.2, 5.1], [1.0, 10.0, 5.0])
    assert (ratio.low, ratio.value, ratio.high) == pytest.approx((1.02, 1.02, 1.02))


def test_the_interval_holds_the_truth_in_95_percent_of_samples() -> None:
    rng = np.random.default_rng(0)
    samples = rng.lognormal(math.log(1.1), 0.05, (1000, 4))
    ratios = [paired_ratio(sample, [1.0] * 4) for sample in samples.tolist()]
    covered = np.mean([ratio.low <= 1.1 <= ratio.high for ratio in ratios])
    assert covered == pytest.approx(0.95, abs=0.02)  # standard error 0.007


@pytest.mark.parametrize(
    ("low", "high", "verdict"),
    [(0.99, 1.03, "kept"), (1.04, 1.2, "missed"), (0.9, 1.1, "open"), (1.03, 1.1, "open")],
)
def test_the_verdict_is_the_intervals(low: float, high: float, verdict: str) -> None:
    assert Ratio(1.0, low, high).verdict(1.03) == verdict


@pytest.mark.parametrize(
    ("ones", "others"), [([1.0], [1.0]), ([1.0, 2.0], [1.0]), ([1.0, 0.0], [1.0, 1.0]), ([], [])]
)
def test_what_gives_no_interval_is_refused(ones: list[float], others: list[float]) -> None:
    with pytest.raises(ValueError, match="needs"):
        paired_ratio(ones, others)
