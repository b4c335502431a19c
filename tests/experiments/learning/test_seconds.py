import pytest

from experiments.learning.seconds import timed


@pytest.mark.slow
def test_a_run_is_timed_beside_what_raw_rates_would_need() -> None:
    row = timed("reach", ["--preset", "smoke", "--env", "reach"], 100.0, 4.0)
    assert (row["env_steps"], row["updates"]) == (800, 16)  # two epochs of two cycles
    assert row["at_raw_rates_s"] == 800 / 100 + 16 / 4
    assert 1 < row["held_s"] < 600
    assert row["cpu_s"] > 1
    assert row["ratio"] == pytest.approx(row["held_s"] / 12, abs=0.01)
    assert row["success_rate"] in [k / 1000 for k in range(1001)]
    assert row["commit"]


def test_a_run_that_fails_is_named() -> None:
    with pytest.raises(RuntimeError, match="train --preset none has failed"):
        timed("reach", ["--preset", "none"], 1.0, 1.0)
