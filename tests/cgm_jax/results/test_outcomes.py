"""What evaluation finds of policies whose behaviour is known."""

# pyright: reportAttributeAccessIssue=false

import json
from pathlib import Path
from typing import Any

import jax
import mujoco
import numpy as np
import pytest
from scipy.stats import binomtest

from cgm_jax.config.fields import SettingError
from cgm_jax.config.settings import Settings
from cgm_jax.envs.fetch import FetchEnvironment
from cgm_jax.loop.environment import make_environment
from cgm_jax.pretrained import NAMES, RECORD, pretrained_policy
from cgm_jax.results import episodes
from cgm_jax.results.chosen import chosen_policies
from cgm_jax.results.episodes import Outcome, Recording
from cgm_jax.results.plan import Plan, goal_mask
from cgm_jax.results.policies import evaluate_policies, evaluate_random
from cgm_jax.storage.run_directory import RunDirectory
from tests.cgm_jax import own_environments
from tests.cgm_jax.reaching import REACH, reaching_runs


@pytest.fixture(scope="module")
def directory(tmp_path_factory: pytest.TempPathFactory) -> RunDirectory:
    return reaching_runs(tmp_path_factory.mktemp("known") / "out")


def evaluate(
    directory: RunDirectory, plan: Plan, run: str | None = None, progress: Any = lambda *_: None
) -> dict[str, Outcome]:
    return evaluate_policies(chosen_policies(directory.path, None, run, {}), plan, progress)


def grips(recording: Recording) -> np.ndarray:
    """Positions [T + 1, K, 3] of the grip, by MuJoCo itself from the recorded states."""
    env = make_environment(REACH)
    assert isinstance(env, FetchEnvironment)
    data = mujoco.MjData(env.scene.model)
    positions = env.physics.positions(recording.states)
    grips = []
    for row in positions.reshape(-1, positions.shape[-1]):
        data.qpos[:] = row
        mujoco.mj_kinematics(env.scene.model, data)
        grips.append(data.site("grip").xpos.copy())
    return np.reshape(grips, (*positions.shape[:-1], 3))


def test_success_is_that_of_the_policies_and_recordings_show_their_states(
    directory: RunDirectory,
) -> None:
    outcomes = evaluate(directory, Plan(episodes=40, seed=3, recorded=25))
    assert list(outcomes) == ["still", "straight"]
    straight, still = outcomes["straight"], outcomes["still"]
    assert (straight.valid, straight.successes) == (40, 40)
    assert still.successes < 15
    assert straight.recording is not None
    goals = np.asarray(straight.recording.desired_goal)
    distance = np.linalg.norm(grips(straight.recording) - goals, axis=-1)
    assert distance.shape == (51, 25)
    np.testing.assert_array_equal(straight.recording.achieved, distance.T < 0.05)


def test_success_under_a_mask_is_that_of_the_kept_axes(directory: RunDirectory) -> None:
    plan = Plan(episodes=60, seed=3, mask="xz", recorded=60)
    still = evaluate(directory, plan, "still")["still"]
    assert still.recording is not None
    offset = grips(still.recording)[-1] - np.asarray(still.recording.desired_goal)
    achieved = np.abs(offset[:, 1]) < 0.05
    assert still.successes == achieved.sum()
    assert 5 < achieved.sum() < 40
    np.testing.assert_array_equal(still.recording.achieved[:, -1], achieved)
    numbered = evaluate(directory, Plan(episodes=60, seed=3, mask="2,0"), "still")
    assert numbered["still"].successes == still.successes


def test_masks_name_dimensions_in_any_order() -> None:
    assert goal_mask("yxz", 3).tolist() == [0, 0, 0]
    assert goal_mask("4,0,2,1", 5).tolist() == [0, 0, 0, 1, 0]


def test_any_dimension_of_a_goal_is_masked_by_its_number() -> None:
    far = Settings(env=f"{own_environments.__file__}:FarInTheFourth")
    successes = {
        mask: evaluate_random(far, Plan(episodes=5, seed=0, mask=mask)).successes
        for mask in ("", "3", "x,3")
    }
    assert successes == {"": 0, "3": 5, "x,3": 5}


def test_random_actions_are_uniform_and_follow_the_seed() -> None:
    first = evaluate_random(REACH, Plan(episodes=30, seed=0, recorded=30)).recording
    other = evaluate_random(REACH, Plan(episodes=30, seed=1, recorded=30)).recording
    assert first is not None
    assert other is not None
    assert np.abs(first.desired_goal - other.desired_goal).max() > 0.01
    fewer = evaluate_random(REACH, Plan(episodes=10, seed=0, recorded=10)).recording
    assert fewer is not None
    np.testing.assert_allclose(first.states.sensors[:, :10], fewer.states.sensors, atol=1e-6)
    steps = np.diff(grips(first), axis=0)[:, :, :2]
    # A full action moves the grip by about 3.2 cm; uniform ones have 1 / sqrt(3) of that.
    assert np.std(steps) == pytest.approx(0.032 / np.sqrt(3), rel=0.15)
    assert np.abs(steps.mean()) < 0.002


def test_chunks_do_not_change_what_is_found(
    directory: RunDirectory, monkeypatch: pytest.MonkeyPatch
) -> None:
    plan = Plan(episodes=50, seed=3, recorded=45)
    whole = evaluate(directory, plan)
    told: list[tuple[int, int]] = []
    monkeypatch.setattr(episodes, "CHUNK_EPISODES", 20)
    monkeypatch.setattr(episodes, "CHUNK_ROWS", 20)  # one policy after the other
    cut = evaluate(directory, plan, progress=lambda *counts: told.append(counts))
    assert told == [(done, 100) for done in (20, 40, 50, 70, 90, 100)]
    assert list(whole) == list(cut)
    for name, outcome in whole.items():
        assert (outcome.valid, outcome.successes) == (cut[name].valid, cut[name].successes)
        recording, again = outcome.recording, cut[name].recording
        assert recording is not None
        assert again is not None
        np.testing.assert_array_equal(recording.desired_goal, again.desired_goal)
        np.testing.assert_array_equal(recording.achieved, again.achieved)
        assert recording.states.sensors.shape == again.states.sensors.shape


def test_what_is_recorded_of_an_own_environment_may_hold_keys(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(episodes, "CHUNK_EPISODES", 4)
    (tmp_path / "mine.py").write_text(
        "from tests.cgm_jax.own_environments import Careless\n\n"
        "class Shown(Careless):\n    def render_frame(self, state, width, height): ...\n"
    )
    careless = Settings(env=f"{tmp_path / 'mine.py'}:Shown")
    recording = evaluate_random(careless, Plan(episodes=6, seed=0, recorded=6)).recording
    assert recording is not None
    keys = jax.random.key_data(recording.states.info["rng"])
    assert keys.shape[:2] == (26, 6)
    assert len(np.unique(keys.reshape(26 * 6, -1), axis=0)) == 26 * 6
    assert recording.states.info["steps"][:, 5].tolist() == list(range(26))


@pytest.mark.parametrize(("field", "value"), [("episodes", 0), ("seed", -1), ("mask", "xx")])
def test_plans_are_checked_where_they_are_made(field: str, value: object) -> None:
    with pytest.raises(SettingError, match=f"^{field}: "):
        Plan(**{"episodes": 1, "seed": 0, field: value})  # pyright: ignore[reportArgumentType]


@pytest.mark.parametrize("name", NAMES)
def test_policies_that_come_with_the_package_are_as_good_as_their_record_says(name: str) -> None:
    recorded = json.loads(RECORD.read_text())[name]
    assert recorded["episodes"] == 1000
    assert recorded["success_rate"] >= 0.98
    outcome = evaluate_policies(
        chosen_policies(None, name, None, {}), Plan(episodes=60, seed=1000)
    )[name]
    chance = binomtest(outcome.successes, outcome.valid, recorded["success_rate"]).pvalue
    assert chance > 1e-3
    assert pretrained_policy(name).stat().st_size < 300_000
