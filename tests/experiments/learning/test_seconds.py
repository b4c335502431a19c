import math
from pathlib import Path

import pytest

from cgm_jax.config.fields import SettingError
from cgm_jax.measuring import figures, rollouts
from cgm_jax.measuring.updates import PRODUCT_OPERATIONS, update_operations
from cgm_jax.measuring.workload import cpu_group
from experiments.learning import seconds
from experiments.learning.seconds import timed
from experiments.table import read_table

SMOKE = ["--preset", "smoke", "--env", "reach"]


@pytest.mark.slow
def test_a_run_is_timed_beside_what_raw_rates_would_need() -> None:
    row = timed("reach", [*SMOKE, "--epochs", "5"], 0.0, 100.0, 4.0)
    assert (row["env_steps"], row["updates"]) == (1200, 24)  # left after three evaluations
    assert row["at_raw_rates_s"] == 1200 / 100 + 24 / 4
    assert 1 < row["held_s"] < 600
    assert row["cpu_s"] > 1
    assert row["ratio"] == pytest.approx(row["held_s"] / 18, abs=0.01)
    assert row["success_rate"] in [k / 1000 for k in range(1001)]


@pytest.mark.slow
def test_a_run_that_never_holds_the_success_has_no_time() -> None:
    row = timed("reach", SMOKE, 1.0, 100.0, 4.0)
    assert (row["env_steps"], row["held_s"], row["ratio"]) == (800, math.inf, math.inf)


def test_the_raw_rate_counts_the_steps_of_whole_episodes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rollouts, "rollout_seconds", lambda *_: (0.0, 2.0))
    monkeypatch.setattr(figures, "medians", lambda calls, repeats: [0.5])
    steps, updates = seconds.raw_rates("push")
    assert steps == 50 * 64 / 2
    agent = cpu_group("push").runs[0].hyper.agent
    # Observation, goal, and what remains of one stage with its flag.
    assert updates == PRODUCT_OPERATIONS / 0.5 / update_operations(agent, 512, 25 + 3 + 4)


def test_runs_that_are_timed_again_replace_their_rows_and_no_others(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    timings = iter((30.0, 40.0, 50.0, 60.0))
    monkeypatch.setattr(seconds, "raw_rates", lambda _: (1.0, 1.0))
    monkeypatch.setattr(seconds, "timed", lambda *_: {"held_s": next(timings)})
    commits = iter(("one", "two"))
    monkeypatch.setattr(
        seconds, "provenance", lambda *_: {"commit": next(commits), "machine": "here"}
    )
    for words in (["push", "--seeds", "2"], ["pick_and_place", "push", "--seeds", "1"]):
        assert seconds.main([*words, "--out", str(tmp_path)]) == 0
    rows = read_table(tmp_path / "seconds.csv")
    assert [(row["task"], row["seed"], row["held_s"], row["commit"]) for row in rows] == [
        ("push", "0", "60.0", "two"),
        ("push", "1", "40.0", "one"),
        ("pick_and_place", "0", "50.0", "two"),
    ]


def test_a_run_that_fails_is_named() -> None:
    with pytest.raises(RuntimeError, match="train --preset none has failed"):
        timed("reach", ["--preset", "none"], 0.9, 1.0, 1.0)


@pytest.mark.parametrize(
    ("words", "message"),
    [(["slide"], "tasks: 'slide' is none of push"), (["--seeds", "0"], "seeds: 0 is below 1")],
)
def test_what_cannot_be_timed_is_refused(words: list[str], message: str) -> None:
    with pytest.raises(SettingError, match=message):
        seconds.main(words)
