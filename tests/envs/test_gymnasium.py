"""The Fetch tasks as Gymnasium environments, one by one and batched."""

# Gymnasium leaves its spaces and environments untyped.
# pyright: reportAttributeAccessIssue=false, reportOptionalMemberAccess=false

import subprocess
import sys
from pathlib import Path
from typing import Any

import gymnasium
import jax.numpy as jnp
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import cgm_jax  # noqa: F401 -- registers the environments
from cgm_jax.envs.gymnasium_vector import FetchVector
from cgm_jax.gymnasium import GoalMasking, VectorGoalMasking
from tests.envs.surface import can_render

NAMES = ("FetchReach", "FetchPush", "FetchPickAndPlace")


def make(name: str, **arguments: Any) -> Any:
    return gymnasium.make(f"cgm_jax/{name}-v0", **arguments)


def make_vec(name: str, num_envs: int, **arguments: Any) -> Any:
    return gymnasium.make_vec(f"cgm_jax/{name}-v0", num_envs=num_envs, **arguments)


def episode(env: Any, seed: int, steps: int = 10) -> list[dict[str, Any]]:
    """Observations under fixed actions."""
    generator = np.random.default_rng(5)
    first, _ = env.reset(seed=seed)
    actions = generator.uniform(-1, 1, (steps, 4)).astype(np.float32)
    return [first, *(env.step(action)[0] for action in actions)]


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
    for a, b in zip(first, second, strict=True):
        for name in a:
            np.testing.assert_array_equal(a[name], b[name])
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


def broken(state: Any) -> Any:
    """The state with a joint at no number."""
    row = np.array(state.pipeline_state.engine_state).view(np.float64).copy()
    row[..., 1] = np.nan
    words = jnp.asarray(row.view(np.uint32))
    return state.replace(pipeline_state=state.pipeline_state.replace(engine_state=words))


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


def test_rows_of_the_vector_environment_are_single_environments_also_after_autoreset() -> None:
    vector = make_vec("FetchPush", num_envs=3, max_episode_steps=7)
    assert isinstance(vector, FetchVector)
    singles = [make("FetchPush", max_episode_steps=7) for _ in range(3)]
    observations, _ = vector.reset(seed=11)
    ones = [env.reset(seed=11 + i)[0] for i, env in enumerate(singles)]
    generator = np.random.default_rng(1)
    goals, ended = [observations["desired_goal"]], False
    for _ in range(17):
        for name, rows in observations.items():
            assert rows.dtype == np.float64
            np.testing.assert_allclose(rows, [one[name] for one in ones], atol=1e-6)
        actions = generator.uniform(-1, 1, (3, 4)).astype(np.float32)
        observations, rewards, terminated, truncated, infos = vector.step(actions)
        if ended:  # the step that resets: the action is without effect
            ones = [env.reset()[0] for env in singles]
            results = [(0.0, False, False, {"is_success": False})] * 3
            assert not infos["_is_success"].any()
            goals.append(observations["desired_goal"])
        else:
            steps = [env.step(action) for env, action in zip(singles, actions, strict=True)]
            ones, results = [step[0] for step in steps], [step[1:] for step in steps]
            assert infos["_is_success"].all()
        np.testing.assert_array_equal(rewards, [result[0] for result in results])
        np.testing.assert_array_equal(terminated, [result[1] for result in results])
        np.testing.assert_array_equal(truncated, [result[2] for result in results])
        np.testing.assert_array_equal(infos["is_success"], [r[3]["is_success"] for r in results])
        ended = bool(truncated[0])
    assert len(goals) == 3
    assert np.abs(np.diff(goals, axis=0)).max(axis=(1, 2)).min() > 1e-3


def test_one_row_whose_physics_breaks_is_reset_while_the_others_go_on() -> None:
    vector = make_vec("FetchReach", num_envs=2)
    before, _ = vector.reset(seed=0)
    breaking, sound = broken(vector.state).pipeline_state, vector.state.pipeline_state
    words = jnp.stack([sound.engine_state[0], breaking.engine_state[1]])
    vector.state = vector.state.replace(pipeline_state=sound.replace(engine_state=words))
    actions = np.tile(np.array([1, 0, 0, 0], np.float32), (2, 1))
    *_, truncated, infos = vector.step(actions)
    assert truncated.tolist() == [False, True]
    assert infos["physics_warnings"][0] == 0 < infos["physics_warnings"][1]
    after, rewards, _, truncated, infos = vector.step(actions)
    assert truncated.tolist() == [False, False]
    assert infos["_is_success"].tolist() == [True, False]
    assert rewards[1] == 0.0
    np.testing.assert_array_equal(after["desired_goal"][0], before["desired_goal"][0])
    assert np.abs(after["desired_goal"][1] - before["desired_goal"][1]).max() > 1e-3
    home = before["achieved_goal"]  # reach starts where it always does
    assert after["achieved_goal"][0, 0] > home[0, 0] + 0.04
    np.testing.assert_allclose(after["achieved_goal"][1], home[1], atol=1e-6)


@pytest.mark.skipif(not can_render(), reason="this machine has no off-screen rendering")
def test_pictures_show_what_happens() -> None:
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
    pictures = vector.render()
    np.testing.assert_array_equal(pictures[0], first)
    assert (pictures[0] != pictures[1]).any()
    vector.close()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"render_mode": "human"}, "render_mode: 'human'"),
        ({"air_probability": 0.5}, "air_probability: the object of push"),
        ({"colour": 1.0}, "colour: no such field"),
    ],
)
def test_bad_arguments_are_refused_by_name(arguments: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        make_vec("FetchPush", num_envs=1, **arguments)


def test_seeds_are_one_per_row() -> None:
    vector = make_vec("FetchReach", num_envs=2)
    counted, _ = vector.reset(seed=7)
    listed, _ = vector.reset(seed=[8, 7])
    np.testing.assert_array_equal(counted["desired_goal"], listed["desired_goal"][::-1])
    with pytest.raises(ValueError, match="seed: 3 seeds for 2"):
        vector.reset(seed=[1, 2, 3])


def test_goals_can_be_masked_by_the_environments_own_threshold() -> None:
    assert GoalMasking(make("FetchPush")).rule.threshold == 0.05
    many = make_vec("FetchPush", num_envs=2, distance_threshold=0.1)
    assert VectorGoalMasking(many).rule.threshold == 0.1


def test_the_readmes_example_runs() -> None:
    readme = (Path(__file__).parents[2] / "README.md").read_text()
    namespace: dict[str, Any] = {}
    exec(readme.split("<!-- gymnasium -->\n```python\n")[1].split("```")[0], namespace)
    assert namespace["observation"]["observation"].shape == (64, 25)
    assert namespace["env"].render_mode == "rgb_array"
