"""A batch of Fetch environments: rows, autoreset, masks, seeds."""

# Gymnasium leaves its spaces and environments untyped.
# pyright: reportAttributeAccessIssue=false, reportOptionalMemberAccess=false

from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from gymnasium.error import ClosedEnvironmentError, ResetNeeded
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space

from cgm_jax.envs.gymnasium.vector import FetchVector
from tests.envs.gymnasium.helpers import assert_same_observations, broken, make, make_vec


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
    breaking, intact = broken(vector.state).pipeline_state, vector.state.pipeline_state
    words = jnp.stack([intact.engine_state[0], breaking.engine_state[1]])
    vector.state = vector.state.replace(pipeline_state=intact.replace(engine_state=words))
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


def test_seeds_are_one_per_row() -> None:
    vector = make_vec("FetchReach", num_envs=2)
    counted, _ = vector.reset(seed=7)
    listed, _ = vector.reset(seed=[8, 7])
    np.testing.assert_array_equal(counted["desired_goal"], listed["desired_goal"][::-1])
    with pytest.raises(ValueError, match="seed: 3 seeds for 2"):
        vector.reset(seed=[1, 2, 3])


def rows(observation: dict[str, np.ndarray], chosen: list[int]) -> list[dict[str, np.ndarray]]:
    return [{name: value[chosen] for name, value in observation.items()}]


def test_a_mask_resets_its_rows_and_leaves_the_others_where_they_are() -> None:
    vector = make_vec("FetchPush", num_envs=3, max_episode_steps=4)
    other = make_vec("FetchPush", num_envs=3, max_episode_steps=4)
    generator = np.random.default_rng(2)
    actions = generator.uniform(-1, 1, (9, 3, 4)).astype(np.float32)
    for env in (vector, other):
        env.reset(seed=7)
        env.step(actions[0])
        last, *_ = env.step(actions[1])
    options = {"reset_mask": np.array([False, True, False])}
    masked, infos = vector.reset(options=options)
    assert infos == {}
    assert list(options) == ["reset_mask"]  # Gymnasium's wrappers look at it afterwards
    assert_same_observations(rows(masked, [0, 2]), rows(last, [0, 2]))
    second_episode, _ = other.reset()  # the second of each row's generator
    assert_same_observations(rows(masked, [1]), rows(second_episode, [1]))
    assert np.abs(masked["desired_goal"][1] - last["desired_goal"][1]).max() > 1e-3
    # Rows 0 and 2 are at their third step, row 1 at its first.
    ends = [vector.step(one)[3].tolist() for one in actions[2:6]]
    assert ends == [[False] * 3, [True, False, True], [False] * 3, [False, True, False]]


def test_a_mask_with_seeds_seeds_only_its_rows() -> None:
    vector = make_vec("FetchPush", num_envs=3)
    first, _ = vector.reset(seed=7)
    mask = np.array([True, False, True])
    masked, _ = vector.reset(seed=20, options={"reset_mask": mask})
    assert vector.np_random_seed == (20, 8, 22)
    assert_same_observations(rows(masked, [1]), rows(first, [1]))
    for row, seed in ((0, 20), (2, 22)):
        alone, _ = make("FetchPush").reset(seed=seed)
        np.testing.assert_allclose(masked["desired_goal"][row], alone["desired_goal"], atol=1e-6)


def test_a_mask_takes_an_ended_row_out_of_autoreset() -> None:
    vector = make_vec("FetchPush", num_envs=3, max_episode_steps=1)
    vector.reset(seed=0)
    up = np.tile(np.array([0, 0, 1, 0], np.float32), (3, 1))
    assert vector.step(up)[3].all()
    before, _ = vector.reset(options={"reset_mask": np.array([True, False, False])})
    after, rewards, _, truncated, infos = vector.step(up)
    assert infos["_is_success"].tolist() == [True, False, False]
    assert truncated.tolist() == [True, False, False]
    assert rewards.tolist() == [-1.0, 0.0, 0.0]
    np.testing.assert_array_equal(after["desired_goal"][0], before["desired_goal"][0])
    assert np.abs(after["desired_goal"][1:] - before["desired_goal"][1:]).max(axis=1).min() > 1e-3


@pytest.mark.parametrize(
    ("mask", "kind"),
    [
        ([True, False, False], TypeError),
        (np.array([1, 0, 0]), TypeError),
        (None, TypeError),
        (np.ones(2, bool), ValueError),
        (np.ones((3, 1), bool), ValueError),
        (np.zeros(3, bool), ValueError),
    ],
)
def test_a_wrong_mask_is_refused_as_by_gymnasiums_own(mask: Any, kind: type[Exception]) -> None:
    vector = make_vec("FetchPush", num_envs=3)
    own = make_vec("FetchPush", num_envs=3, vectorization_mode="sync")
    for env in (vector, own):
        env.reset(seed=0)
        with pytest.raises(kind, match="reset_mask"):
            env.reset(options={"reset_mask": mask})


def test_masks_of_all_rows_may_come_first_and_others_may_not() -> None:
    vector = make_vec("FetchPush", num_envs=3)
    with pytest.raises(ResetNeeded, match="all rows"):
        vector.reset(options={"reset_mask": np.array([True, False, True])})
    masked, _ = vector.reset(seed=4, options={"reset_mask": np.ones(3, bool)})
    plain, _ = make_vec("FetchPush", num_envs=3).reset(seed=4)
    assert_same_observations([masked], [plain])


@pytest.mark.parametrize("options", [{"goal": 1}, {"reset_mask": np.ones(3, bool), "goal": 1}])
def test_other_options_are_refused(options: dict[str, Any]) -> None:
    vector = make_vec("FetchPush", num_envs=3)
    with pytest.raises(ValueError, match="options: 'goal' has no effect"):
        vector.reset(options=options)
    with pytest.raises(TypeError, match="options: "):
        vector.reset(options=[1])


def test_the_seed_of_each_row_can_be_read() -> None:
    vector = make_vec("FetchPush", num_envs=3)
    drawn = vector.np_random_seed  # from the system's entropy, as long as none is given
    assert len({*drawn, *make_vec("FetchPush", num_envs=3).np_random_seed}) == 6
    unseeded, _ = vector.reset()
    assert vector.np_random_seed == drawn
    again, _ = vector.reset(seed=drawn)
    assert_same_observations([unseeded], [again])
    vector.reset(seed=7)
    assert vector.np_random_seed == (7, 8, 9)
    vector.reset(seed=[None, 5, None])
    assert vector.np_random_seed == (7, 5, 9)
    assert len(vector.np_random) == 3


def test_spaces_are_those_of_single_environments() -> None:
    vector, env = make_vec("FetchPush", num_envs=3), make("FetchPush")
    assert vector.single_observation_space == env.observation_space
    assert vector.single_action_space == env.action_space
    assert vector.observation_space == batch_space(env.observation_space, 3)
    assert vector.action_space == batch_space(env.action_space, 3)
    own = make_vec("FetchPush", num_envs=3, vectorization_mode="sync")
    assert vector.observation_space == own.observation_space
    assert vector.metadata["autoreset_mode"] is AutoresetMode.NEXT_STEP
    observation, _ = vector.reset(seed=0)
    assert observation in vector.observation_space
    observation, *_ = vector.step(vector.action_space.sample())
    assert observation in vector.observation_space


def test_order_is_enforced_and_a_closed_batch_says_so() -> None:
    vector = make_vec("FetchPush", num_envs=3, render_mode="rgb_array")
    with pytest.raises(ResetNeeded, match="call reset before step"):
        vector.step(np.zeros((3, 4)))
    with pytest.raises(ResetNeeded, match="call reset before render"):
        vector.render()
    vector.reset(seed=0)
    vector.close()
    vector.close()
    for method in (vector.reset, vector.render, lambda: vector.step(np.zeros((3, 4)))):
        with pytest.raises(ClosedEnvironmentError):
            method()


def test_rendering_without_a_render_mode_warns_and_gives_nothing() -> None:
    vector = make_vec("FetchPush", num_envs=3)
    vector.reset(seed=0)
    with pytest.warns(UserWarning, match='render_mode="rgb_array"'):
        assert vector.render() is None
