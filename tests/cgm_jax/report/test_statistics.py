import pytest

from cgm_jax.report.statistics import first_to_reach, wilson_interval


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
