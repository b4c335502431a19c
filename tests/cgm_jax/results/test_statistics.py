import math

import pytest

from cgm_jax.results.statistics import first_to_reach, quartiles, wilson_interval


def test_a_quartile_between_arrival_and_none_is_none() -> None:
    assert quartiles([5.0, 1.0, 3.0, 2.0, 4.0]) == (2.0, 3.0, 4.0)
    assert quartiles([1.0, math.inf]) == (math.inf, math.inf, math.inf)
    assert quartiles([math.inf, 2.0, 1.0]) == (2.0, 2.0, math.inf)
    assert quartiles([7.0]) == (7.0, 7.0, 7.0)


def test_wilson_interval_by_hand() -> None:
    # Newcombe (1998), table I: 81 of 263, and the corner of 0 of 20.
    low, high = wilson_interval(81, 263)
    assert (low, high) == (pytest.approx(0.2553, abs=1e-4), pytest.approx(0.3662, abs=1e-4))
    low, high = wilson_interval(0, 20)
    assert (low, high) == (0.0, pytest.approx(0.1611, abs=1e-4))
    with pytest.raises(ValueError, match="at least one trial"):
        wilson_interval(0, 0)


def test_first_to_reach() -> None:
    rows = [{"success_rate": rate} for rate in (0.1, None, 0.5, 0.4, 0.9)]
    assert first_to_reach(rows, 0.5) is rows[2]
    assert first_to_reach(rows, 0.95) is None
