import math

import numpy as np
import pytest

from cgm_jax.results.statistics import (
    first_to_hold,
    holds,
    median_interval,
    quartiles,
    wilson_interval,
)


def test_quartiles_are_interpolated_as_numpy_does() -> None:
    assert quartiles([4.0, 1.0, 3.0, 2.0]) == (1.75, 2.5, 3.25)
    assert quartiles([7.0]) == (7.0, 7.0, 7.0)
    for count in range(1, 9):
        values = np.random.default_rng(count).uniform(0.0, 100.0, count)
        np.testing.assert_allclose(quartiles(list(values)), np.quantile(values, (0.25, 0.5, 0.75)))


def test_what_is_interpolated_towards_a_run_that_never_arrived_is_infinite() -> None:
    assert quartiles([1.0, math.inf]) == (math.inf, math.inf, math.inf)
    assert quartiles([math.inf, 2.0, 1.0]) == (1.5, 2.0, math.inf)
    assert quartiles([1.0, 2.0, 3.0, 4.0, math.inf]) == (2.0, 3.0, 4.0)
    assert quartiles([math.inf] * 3) == (math.inf, math.inf, math.inf)


def test_a_success_is_held_by_the_mean_of_three_evaluations() -> None:
    rows = [{"success_rate": rate} for rate in (0.9, None, 0.3, 0.4, 0.9)]
    assert first_to_hold(rows, 0.5) is rows[4]  # means 0.4, 0.233, 0.533
    assert first_to_hold(rows, 0.4) is rows[2]
    assert first_to_hold(rows, 0.6) is None
    assert first_to_hold(rows[:2], 0.1) is None  # two evaluations hold nothing


def test_rounding_does_not_decide_whether_a_success_is_held() -> None:
    rates = [0.94, 0.86, 0.90]  # 47, 43 and 45 of 50
    assert sum(rates) / 3 < 0.9 == sum((47, 43, 45)) / 150
    assert holds(rates, 0.9)
    assert not holds([0.94, 0.86, 0.88], 0.9)


def test_wilson_interval_by_hand() -> None:
    # Newcombe (1998), table I: 81 of 263, and the corner of 0 of 20.
    low, high = wilson_interval(81, 263)
    assert (low, high) == (pytest.approx(0.2553, abs=1e-4), pytest.approx(0.3662, abs=1e-4))
    low, high = wilson_interval(0, 20)
    assert (low, high) == (0.0, pytest.approx(0.1611, abs=1e-4))
    with pytest.raises(ValueError, match="at least one trial"):
        wilson_interval(0, 0)


def test_intervals_of_medians_by_hand() -> None:
    # 2 / 2^5 = 6 % is too much, 2 / 2^6 = 3 % is not; of ten, 2 (1 + 10) / 2^10 = 2 %.
    assert median_interval([1, 2, 3, 4, 5]) is None
    assert median_interval([6, 1, 2, 3, 4, 5]) == (1, 6)
    assert median_interval(range(10)) == (1, 8)
    assert median_interval(range(5), confidence=0.9) == (0, 4)


def test_intervals_of_medians_cover_what_they_promise() -> None:
    draws = np.random.default_rng(0).exponential(size=(4000, 10))
    intervals = [median_interval(values) or (0, 0) for values in draws]
    covered = np.mean([low <= np.log(2) <= high for low, high in intervals])
    assert covered == pytest.approx(1 - 22 / 1024, abs=0.01)
