"""What becomes of episodes in which the physics engine gives up."""

import json
import subprocess
import sys
from pathlib import Path

import jax
import numpy as np
import pytest

from cgm_jax.host.progress import physics_lines
from cgm_jax.loop.training import make_trainer
from tests.cgm_jax.broken_fetch import BrokenFetch
from tests.cgm_jax.probe import TINY, tiny

ROOT = Path(__file__).parents[2]


@pytest.mark.slow
def test_broken_episodes_reach_neither_replay_nor_normaliser_nor_statistics() -> None:
    env = BrokenFetch()
    trainer, hyper = make_trainer(env, TINY), tiny(her=False)
    state = jax.jit(trainer.train)(trainer.init(hyper), hyper, 3)

    kept, played = int(state.replay.inserted), 3 * TINY.environments
    assert 0 < kept < played
    assert int(state.statistics.physics_warnings) == played - kept
    assert int(state.statistics.mask_episodes.sum()) == kept

    observed = np.asarray(state.replay.episodes.observation[:kept])
    assert np.isfinite(observed).all()
    assert observed[:, 0, 3].max() <= env.env.scene.grip_home[0]  # only healthy starts
    mean = np.asarray(state.normaliser.observation.mean)
    np.testing.assert_allclose(mean, observed.mean(axis=(0, 1)), atol=1e-4)

    state, metrics = jax.jit(trainer.evaluate)(state, hyper)
    dropped = int(metrics["physics_warnings"]) - (played - kept)
    assert 0 < dropped < TINY.evaluation_episodes
    assert int(state.curriculum.subgoals.count) == TINY.evaluation_episodes - dropped


def test_the_summary_names_the_run_with_most_broken_episodes() -> None:
    rows = [{"run": "a", "physics_warnings": 1.0}, {"run": "b", "physics_warnings": 2.0}]
    rows += [{"run": "a", "physics_warnings": 3.0}, {"run": "c", "physics_warnings": 0.0}]
    assert physics_lines(rows) == ["physics broke in 6 episodes, which were dropped; most in a"]
    assert physics_lines(rows[3:]) == []


@pytest.mark.slow
def test_training_counts_broken_episodes_and_says_so(tmp_path: Path) -> None:
    out = tmp_path / "out"
    env = "tests/cgm_jax/broken_fetch.py:BrokenFetch"
    command = [sys.executable, "-m", "cgm_jax.train", "--preset", "smoke", "--env", env]
    result = subprocess.run(
        [*command, "--out", str(out)],
        capture_output=True,
        text=True,
        timeout=300,
        cwd=ROOT,
        check=False,
    )
    assert result.returncode == 0, result.stderr
    rows = [json.loads(line) for line in (out / "metrics.jsonl").read_text().splitlines()]
    assert all(row["physics_warnings"] > 0 for row in rows)
    total = sum(int(row["physics_warnings"]) for row in rows)
    assert f"physics broke in {total} episodes, which were dropped" in result.stdout
