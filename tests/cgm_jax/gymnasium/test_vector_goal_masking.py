"""`VectorGoalMasking`: its rows are single `GoalMasking` environments."""

# Gymnasium leaves its spaces and environments untyped.
# pyright: reportIndexIssue=false, reportArgumentType=false

from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium import spaces
from gymnasium.vector import AsyncVectorEnv, AutoresetMode, SyncVectorEnv

from cgm_jax.gymnasium import GoalMasking, VectorGoalMasking
from tests.examples.numpy_point_mass import NumpyPointMass

OUTCOMES = [[1, 1], [1, 0], [1, 0], [0, 0]]


class Brief(NumpyPointMass):
    """Episodes of 3 steps if they start to the right of the middle, else of 5."""

    def reset(self, **arguments: Any) -> Any:
        result = super().reset(**arguments)
        self.episode_length = 3 if self._position[0] > 0 else 5
        return result


def vector(mode: AutoresetMode = AutoresetMode.NEXT_STEP, rows: int = 3, **arguments: Any) -> Any:
    env = SyncVectorEnv([Brief] * rows, autoreset_mode=mode)
    masked = VectorGoalMasking(env, **{"kappa": 1.0, **arguments})
    masked.record_evaluation(OUTCOMES)
    masked.action_space.seed(0)
    return masked


def singles(rows: int = 3, **arguments: Any) -> list[GoalMasking]:
    envs = [GoalMasking(Brief(), **{"kappa": 1.0, **arguments}) for _ in range(rows)]
    for env in envs:
        env.record_evaluation(OUTCOMES)
    return envs


def assert_rows(observations: dict[str, np.ndarray], rows: list[dict[str, np.ndarray]]) -> None:
    for name, batch in observations.items():
        np.testing.assert_array_equal(batch, [row[name] for row in rows])


@pytest.mark.parametrize("evaluating", [False, True])
def test_rows_are_single_environments_also_after_autoreset(evaluating: bool) -> None:
    many, ones = vector(evaluating=evaluating), singles(evaluating=evaluating)
    observations, infos = many.reset(seed=11)
    rows, row_infos = zip(*[env.reset(seed=11 + i) for i, env in enumerate(ones)], strict=True)
    rows, ended, masks = list(rows), [False] * 3, [infos["mask"]]
    np.testing.assert_array_equal(infos["mask"], [info["mask"] for info in row_infos])
    for _ in range(40):
        assert_rows(observations, rows)
        assert observations in many.observation_space
        actions = many.action_space.sample()
        observations, rewards, terminated, truncated, infos = many.step(actions)
        for i, env in enumerate(ones):
            if ended[i]:  # the step that resets: the action is without effect
                rows[i], info = env.reset()
                assert (rewards[i], truncated[i]) == (0.0, False)
                for name in ("is_success", "masked_success", "subgoal_success"):
                    assert not np.any(infos[name][i])
                    assert not infos[f"_{name}"][i]
            else:
                rows[i], reward, _, ended_now, info = env.step(actions[i])
                assert (rewards[i], truncated[i]) == (reward, ended_now)
                for name in ("is_success", "masked_success", "subgoal_success"):
                    assert infos[f"_{name}"][i]
                    np.testing.assert_array_equal(infos[name][i], info[name])
            np.testing.assert_array_equal(infos["mask"][i], info["mask"])
            ended[i] = bool(truncated[i])
        assert not terminated.any()
        masks.append(infos["mask"])
    different = len(np.unique(np.reshape(masks, (-1, 2)), axis=0))
    assert different == 1 if evaluating else different >= 3


def test_where_its_user_resets_only_those_rows_get_new_masks() -> None:
    many, ones = vector(AutoresetMode.DISABLED, kappa=0.0), singles(kappa=0.0)
    many.reset(seed=0)
    rows = [env.reset(seed=i)[0] for i, env in enumerate(ones)]
    for step in range(1, 4):
        actions = many.action_space.sample()
        observations, *_ = many.step(actions)
        rows = [env.step(action)[0] for env, action in zip(ones, actions, strict=True)]
        assert_rows(observations, rows)
        chosen = np.array([step == 1, True, False])
        observations, infos = many.reset(seed=40 * step, options={"reset_mask": chosen})
        for i in np.flatnonzero(chosen):
            rows[i], info = ones[i].reset(seed=40 * step + int(i))
            np.testing.assert_array_equal(infos["mask"][i], info["mask"])
        np.testing.assert_array_equal(infos["_mask"], chosen)
        assert_rows(observations, rows)
    for _ in range(10):  # rows that were not reset have not taken the seed either
        observations, infos = many.reset()
        rows, row_infos = zip(*[env.reset() for env in ones], strict=True)
        assert_rows(observations, list(rows))
        np.testing.assert_array_equal(infos["mask"], [info["mask"] for info in row_infos])


def test_masks_can_be_chosen_for_all_rows_or_for_each() -> None:
    many = vector(rows=2)
    _, infos = many.reset(options={"mask": [1, 0]})
    np.testing.assert_array_equal(infos["mask"], [[1, 0], [1, 0]])
    options = {"mask": [[0, 1], [1, 1]], "reset_mask": np.array([True, False])}
    observations, infos = many.reset(options=options)
    np.testing.assert_array_equal(infos["mask"], [[0, 1], [1, 0]])
    achieved, desired = observations["achieved_goal"], observations["desired_goal"]
    np.testing.assert_array_equal(achieved == desired, [[True, False], [False, True]])
    assert set(options) == {"mask", "reset_mask"}
    with pytest.raises(ValueError, match=r"mask: shape \(3,\) is not \(2, 2\)"):
        many.reset(options={"mask": [1, 0, 1]})


def test_seeds_may_be_listed_and_none_goes_on() -> None:
    many, counted = vector(kappa=0.0), vector(kappa=0.0)
    a, a_infos = many.reset(seed=[5, 6, 7])
    b, b_infos = counted.reset(seed=5)
    for _ in range(5):
        np.testing.assert_array_equal(a["desired_goal"], b["desired_goal"])
        np.testing.assert_array_equal(a_infos["mask"], b_infos["mask"])
        (a, a_infos), (b, b_infos) = many.reset(), counted.reset(seed=[None] * 3)


def test_rewards_of_batches_and_spaces() -> None:
    many = vector()
    achieved, goals = np.array([[0.0, 0.0], [1.0, 1.0]]), np.array([[0.06, 0.06], [1.0, 1.2]])
    np.testing.assert_array_equal(many.compute_reward(achieved, goals, {}), [0.0, -1.0])
    goal = spaces.Box(-6.0, 6.0, (2,), np.float64)
    assert many.single_observation_space["desired_goal"] == goal
    assert many.observation_space["desired_goal"].shape == (3, 2)
    assert many.observation_space["desired_goal"].low.min() == -6.0


def test_the_threshold_is_that_of_the_environments_in_it() -> None:
    assert vector().rule.threshold == 0.1
    with pytest.raises(ValueError, match="distance_threshold: the environment has no attribute"):
        VectorGoalMasking(SyncVectorEnv([Untold]))


class Untold(NumpyPointMass):
    """Keeps its threshold to itself."""

    @property
    def distance_threshold(self) -> float:  # pyright: ignore[reportIncompatibleVariableOverride]
        raise AttributeError("distance_threshold")


def test_environments_of_several_thresholds_need_one_that_is_given() -> None:
    class Wide(NumpyPointMass):
        distance_threshold = 0.5

    with pytest.raises(ValueError, match="distance_threshold: the environments differ in theirs"):
        VectorGoalMasking(SyncVectorEnv([NumpyPointMass, Wide]))
    both = SyncVectorEnv([NumpyPointMass, Wide])
    assert VectorGoalMasking(both, distance_threshold=0.2).rule.threshold == 0.2


def test_processes_live_on_where_their_environments_have_no_threshold() -> None:
    env = AsyncVectorEnv([Untold] * 2, context="spawn")
    try:
        with pytest.raises(
            ValueError, match="distance_threshold: the environment has no attribute"
        ):
            VectorGoalMasking(env)
        observation, _ = VectorGoalMasking(env, distance_threshold=0.1).reset(seed=0)
        assert observation["achieved_goal"].shape == (2, 2)
    finally:
        env.close()


def test_what_is_no_switch_and_no_options_is_refused() -> None:
    for wrap in (lambda: vector(evaluating="no"), lambda: GoalMasking(Brief(), evaluating="no")):
        with pytest.raises(ValueError, match="evaluating: 'no' is neither True nor False"):
            wrap()
    with pytest.raises(TypeError, match=r"options: \[1\] is neither a dict nor None"):
        vector().reset(options=[1])


def test_environments_in_other_processes_are_masked_alike() -> None:
    many = VectorGoalMasking(AsyncVectorEnv([Brief] * 2, context="spawn"), kappa=0.0)
    try:
        assert many.rule.threshold == 0.1
        expected = VectorGoalMasking(SyncVectorEnv([Brief] * 2), kappa=0.0)
        for env in (many, expected):
            env.reset(seed=1)
        for _ in range(8):
            actions = many.action_space.sample()
            (one, *_), (other, *_) = many.step(actions), expected.step(actions)
            np.testing.assert_array_equal(one["desired_goal"], other["desired_goal"])
    finally:
        many.close()


def test_resets_within_a_step_are_left_to_single_wrappers() -> None:
    with pytest.raises(ValueError, match="SAME_STEP is neither NEXT_STEP nor DISABLED; wrap each"):
        vector(AutoresetMode.SAME_STEP)
    env = SyncVectorEnv(
        [lambda: GoalMasking(Brief(), evaluating=True)] * 2, autoreset_mode=AutoresetMode.SAME_STEP
    )
    env.reset(seed=0)
    env.action_space.seed(0)
    outcomes: list[np.ndarray] = []
    for _ in range(12):
        *_, truncated, infos = env.step(env.action_space.sample())
        if truncated.any():
            outcomes += list(infos["final_info"]["subgoal_success"][truncated])
    assert len(outcomes) >= 4
    env.call("record_evaluation", np.array(outcomes))
    for sampler in env.get_attr("sampler"):
        np.testing.assert_array_equal(sampler.outcomes, outcomes[-10:])


def test_a_step_needs_a_reset() -> None:
    with pytest.raises(gymnasium.error.ResetNeeded, match="call reset before step"):
        vector().step(np.zeros((3, 2)))


class Wide(NumpyPointMass):
    """Has goals far away."""

    def __init__(self) -> None:
        super().__init__()
        far = {name: spaces.Box(-50.0, 50.0, (2,), np.float64) for name in GOALS}
        inner: Any = self.observation_space
        self.observation_space = spaces.Dict({**inner.spaces, **far})

    def reset(self, **options: Any) -> tuple[Any, dict[str, Any]]:
        super().reset(**options)
        self._goal = 40.0 * self._goal
        return self._observation(), {}


GOALS = ("achieved_goal", "desired_goal")


def test_rows_whose_goals_have_bounds_of_their_own_are_in_the_space() -> None:
    inner = SyncVectorEnv([NumpyPointMass, Wide], observation_mode="different")
    env = VectorGoalMasking(inner, evaluating=True)
    observation, _ = env.reset(seed=0)
    assert np.abs(observation["desired_goal"][1]).max() > 6.0
    assert observation in env.observation_space
    low = env.observation_space["desired_goal"].low  # pyright: ignore
    np.testing.assert_array_equal(low, [[-6.0, -6.0], [-50.0, -50.0]])
