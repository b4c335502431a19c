"""The Fetch tasks as Gymnasium environments, one by one."""

# Gymnasium leaves its spaces and environments untyped.
# pyright: reportAttributeAccessIssue=false, reportOptionalMemberAccess=false

import subprocess
import sys
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from gymnasium.error import ResetNeeded
from gymnasium.utils.env_checker import check_env

from cgm_jax.gymnasium import GoalMasking, VectorGoalMasking
from tests.envs.gymnasium.helpers import (
    NAMES,
    assert_same_observations,
    broken,
    episode,
    make,
    make_vec,
)
from tests.envs.surface import can_render


@pytest.mark.parametrize("name", NAMES)
def test_gymnasiums_own_checker_has_no_complaint(name: str) -> None:
    env = make(name, render_mode="rgb_array")
    check_env(env.unwrapped, skip_render_check=not can_render())  # warnings are errors here
    assert env.unwrapped.metadata["render_fps"] == 25
    env.close()


def test_the_ids_are_known_after_an_import_that_loads_no_jax() -> None:
    program = (
        "import sys, cgm_jax, gymnasium;"
        "assert 'jax' not in sys.modules;"
        "print(*(name for name in gymnasium.registry if name.startswith('cgm_jax/')))"
    )
    result = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert result.stdout.split() == [f"cgm_jax/{name}-v0" for name in NAMES], result.stderr


def test_the_seed_decides_start_and_goal_and_those_of_later_episodes() -> None:
    one, other = make("FetchPush"), make("FetchPush")
    first, second = episode(one, seed=3), episode(other, seed=3)
    first.append(one.reset()[0])
    second.append(other.reset()[0])
    assert_same_observations(first, second)
    assert np.abs(first[-1]["desired_goal"] - first[0]["desired_goal"]).max() > 1e-3
    different = episode(one, seed=4)
    assert np.abs(different[0]["desired_goal"] - first[0]["desired_goal"]).max() > 1e-3
    assert np.abs(different[0]["achieved_goal"] - first[0]["achieved_goal"]).max() > 1e-3


def test_pick_and_place_has_half_of_its_goals_in_the_air_as_in_gymnasium_robotics() -> None:
    def share_in_the_air(**fields: float) -> float:
        vector = make_vec("FetchPickAndPlace", num_envs=2000, **fields)
        goals = vector.reset(seed=0)[0]["desired_goal"]
        return float(np.mean(goals[:, 2] > 0.4248))

    assert share_in_the_air() == pytest.approx(0.5, abs=0.04)
    assert share_in_the_air(air_probability=1.0) > 0.99


def test_reward_is_that_of_the_distance_for_goals_one_by_one_and_in_batches() -> None:
    env = make("FetchPush").unwrapped
    generator = np.random.default_rng(0)
    desired = generator.uniform(-1, 1, (6, 5, 3))
    achieved = desired + generator.uniform(-0.05, 0.05, desired.shape)
    distance = ((achieved - desired) ** 2).sum(axis=-1) ** 0.5
    expected = [[0.0 if d < 0.05 else -1.0 for d in row] for row in distance]
    assert {0.0, -1.0} == set(np.ravel(expected))
    rewards = env.compute_reward(achieved, desired, [{}] * 6)
    np.testing.assert_array_equal(rewards, expected)
    for i in range(6):
        single = env.compute_reward(achieved[i, 0], desired[i, 0], {})
        assert isinstance(single, float)
        assert single == expected[i][0]


def test_success_and_reward_at_a_state_made_by_hand() -> None:
    env = make("FetchPush")
    env.reset(seed=0)
    inner = env.unwrapped
    for offset, success in ((0.045, True), (0.055, False)):
        goal = jnp.array([1.25, 0.6 + offset, 0.4247])
        inner.state = inner.fetch.reset_to(jnp.array([1.25, 0.6]), goal)
        observation, reward, terminated, truncated, info = env.step(np.zeros(4, np.float32))
        np.testing.assert_allclose(observation["achieved_goal"], [1.25, 0.6, 0.4247], atol=2e-4)
        assert info["is_success"] is success
        assert reward == (0.0 if success else -1.0)
        assert (terminated, truncated) == (False, False)
        pair = observation["achieved_goal"], observation["desired_goal"]
        assert reward == inner.compute_reward(*pair, info)
        assert inner.compute_terminated(*pair, info) is False
        assert inner.compute_truncated(*pair, info) is False


def test_an_episode_takes_fifty_steps_or_ends_where_its_physics_breaks() -> None:
    env = make("FetchReach")
    env.reset(seed=0)
    ends = [env.step(np.zeros(4, np.float32))[3] for _ in range(50)]
    assert ends == [False] * 49 + [True]
    env.reset()
    env.unwrapped.state = broken(env.unwrapped.state)
    *_, truncated, info = env.step(np.zeros(4, np.float32))
    assert truncated
    assert info["physics_warnings"] > 0


def test_what_follows_from_information_that_is_missing_or_of_many() -> None:
    env = make("FetchReach").unwrapped
    pair = np.zeros(3), np.zeros(3)
    assert env.compute_reward(*pair, None) == 0.0
    assert env.compute_reward(achieved_goal=pair[0], desired_goal=pair[1] + 1, info=None) == -1.0
    assert env.compute_terminated(achieved_goal=pair[0], desired_goal=pair[1], info=None) is False
    assert env.compute_truncated(achieved_goal=pair[0], desired_goal=pair[1], info=None) is False
    assert env.compute_truncated(*pair, {}) is False
    assert env.compute_truncated(*pair, {"physics_warnings": 2}) is True
    many = [{"physics_warnings": 1}, {}, None]
    assert env.compute_truncated(*pair, many).tolist() == [True, False, False]
    batched = {"physics_warnings": np.array([0, 3])}
    assert env.compute_truncated(*pair, batched).tolist() == [False, True]


def test_the_seed_that_was_given_can_be_read_and_the_generator_replaced() -> None:
    env = make("FetchReach")
    env.reset(seed=123)
    env.reset()
    assert env.np_random_seed == env.unwrapped.np_random_seed == 123
    inner = make("FetchReach").unwrapped
    inner.np_random = np.random.default_rng(9)
    goals = [inner.reset()[0]["desired_goal"] for _ in range(2)]
    inner.np_random = np.random.default_rng(9)
    np.testing.assert_array_equal(inner.reset()[0]["desired_goal"], goals[0])
    assert inner.np_random_seed == -1
    assert np.abs(goals[0] - goals[1]).max() > 1e-3


def test_a_closed_environment_can_be_closed_again_and_used() -> None:
    env = make("FetchReach")
    first = episode(env, seed=1, steps=3)
    env.close()
    env.close()
    assert_same_observations(first, episode(env, seed=1, steps=3))


def test_order_is_enforced_without_wrappers_too() -> None:
    inner = make("FetchReach", render_mode="rgb_array").unwrapped
    for method in (lambda: inner.step(np.zeros(4)), inner.render):
        with pytest.raises(ResetNeeded, match="call reset before"):
            method()


def test_rendering_without_a_render_mode_warns_and_gives_nothing() -> None:
    inner = make("FetchReach").unwrapped
    inner.reset(seed=0)
    with pytest.warns(UserWarning, match='render_mode="rgb_array"'):
        assert inner.render() is None


@pytest.mark.skipif(not can_render(), reason="this machine has no off-screen rendering")
def test_frames_show_what_happens() -> None:
    env = make("FetchPush", render_mode="rgb_array", width=160, height=120)
    env.reset(seed=0)
    first = env.render()
    assert first.shape == (120, 160, 3)
    assert first.dtype == np.uint8
    np.testing.assert_array_equal(env.render(), first)
    for _ in range(5):
        env.step(np.array([0, 1, 1, 0], np.float32))
    assert (np.abs(env.render().astype(int) - first) > 40).any(axis=-1).mean() > 0.02
    env.close()

    vector = make_vec("FetchPush", num_envs=2, render_mode="rgb_array", width=160, height=120)
    vector.reset(seed=0)
    frames = vector.render()
    np.testing.assert_array_equal(frames[0], first)
    assert (frames[0] != frames[1]).any()
    vector.close()


def test_goals_can_be_masked_by_the_environments_own_threshold() -> None:
    assert GoalMasking(make("FetchPush")).rule.threshold == 0.05
    many = make_vec("FetchPush", num_envs=2, distance_threshold=0.1)
    assert VectorGoalMasking(many).rule.threshold == 0.1


def test_the_readmes_example_runs() -> None:
    readme = (Path(__file__).parents[3] / "README.md").read_text()
    namespace: dict[str, Any] = {}
    exec(readme.split("<!-- gymnasium -->\n```python\n")[1].split("```")[0], namespace)
    assert namespace["observation"]["observation"].shape == (64, 25)
    assert namespace["env"].render_mode == "rgb_array"
