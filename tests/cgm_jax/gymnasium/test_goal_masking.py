"""`GoalMasking` on a numpy environment, step by step, and on environments made for one question."""

# Gymnasium leaves its spaces and environments untyped.
# pyright: reportIndexIssue=false, reportArgumentType=false

import copy
import pickle
import subprocess
import sys
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium import spaces
from gymnasium.envs.registration import EnvSpec
from gymnasium.utils.env_checker import check_env

from cgm_jax.gymnasium import GoalMasking
from tests.examples.numpy_point_mass import NumpyPointMass


class Scripted(gymnasium.Env[Any, Any]):
    """Achieves what the action says; the goal is (1, 2, 3)."""

    action_space = spaces.Box(-9.0, 9.0, (3,), np.float64)

    def __init__(self, information: dict[str, Any] | None = None, **entries: Any) -> None:
        box = spaces.Box(-9.0, 9.0, (3,), np.float64)
        goals = dict.fromkeys(("observation", "achieved_goal", "desired_goal"), box)
        self.observation_space = spaces.Dict({**goals, **entries})
        self.information = information or {}
        self.options: list[dict[str, Any] | None] = []

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:
        super().reset(seed=seed)
        self.options.append(options)
        return self.observe(np.zeros(3)), {"hint": 7}

    def step(self, action: np.ndarray) -> Any:
        return self.observe(action), -0.25, action[0] > 8, action[1] > 8, dict(self.information)

    def observe(self, achieved: np.ndarray) -> dict[str, np.ndarray]:
        return {
            "observation": np.full(3, 5.0),
            "achieved_goal": np.array(achieved, np.float64),
            "desired_goal": np.array([1.0, 2.0, 3.0]),
        }


def scripted(env: Scripted | None = None, **arguments: Any) -> GoalMasking:
    return GoalMasking(env or Scripted(), **{"distance_threshold": 0.1, **arguments})


def point_masses(**arguments: Any) -> tuple[GoalMasking, NumpyPointMass]:
    env = GoalMasking(NumpyPointMass(), **arguments)
    env.action_space.seed(0)
    return env, NumpyPointMass()


def test_an_episode_under_a_mask_worked_by_hand() -> None:
    env = scripted()
    observation, info = env.reset(options={"mask": [1, 0, 1]})
    np.testing.assert_array_equal(observation["desired_goal"], [1, 0, 3])
    np.testing.assert_array_equal(info["mask"], [True, False, True])
    assert info["hint"] == 7

    # Masked dimensions follow what is achieved; x and z are still to come.
    observation, reward, terminated, truncated, info = env.step(np.array([1.05, -4.0, 0.0]))
    np.testing.assert_array_equal(observation["desired_goal"], [1, -4, 3])
    np.testing.assert_array_equal(observation["observation"], [5, 5, 5])
    assert (reward, terminated, truncated) == (-1.0, False, False)
    assert not info["masked_success"]
    np.testing.assert_array_equal(info["subgoal_success"], [True, False, False])

    # (0.06, 0.06) is within 0.1 of the goal in x and z; y does not count.
    observation, reward, *_, info = env.step(np.array([1.06, -4.0, 3.06]))
    assert reward == 0.0
    assert info["masked_success"]
    assert info["is_success"] is False
    np.testing.assert_array_equal(info["subgoal_success"], [True, False, True])

    # Each within 0.1, but not their distance.
    _, reward, *_, info = env.step(np.array([1.08, -4.0, 3.08]))
    assert reward == -1.0
    np.testing.assert_array_equal(info["subgoal_success"], [True, False, True])

    _, reward, *_, info = env.step(np.array([1.0, 2.05, 3.0]))
    assert info["is_success"] is True
    assert reward == 0.0


def test_per_dimension_thresholds_worked_by_hand() -> None:
    env = scripted(distance_threshold=[0.1, 0.1, 1.0], distance="per_dimension")
    env.reset(options={"mask": [1, 0, 1]})
    for achieved, masked, full in (
        ([1.08, -4.0, 3.9], True, False),
        ([1.08, 2.09, 3.9], True, True),
        ([1.12, 2.09, 3.9], False, False),
        ([1.08, 2.09, 4.1], False, False),
    ):
        _, reward, *_, info = env.step(np.array(achieved))
        assert reward == (0.0 if masked else -1.0)
        assert info["masked_success"] is masked
        assert info["is_success"] is full


def test_ends_and_what_the_environment_says_stay_as_they_are() -> None:
    env = scripted(Scripted({"is_success": "as I say", "speed": 3}))
    env.reset(options={"mask": [0, 0, 0]})
    _, reward, terminated, truncated, info = env.step(np.array([9.0, 0.0, 0.0]))
    assert (reward, terminated, truncated) == (0.0, True, False)
    assert (info["is_success"], info["speed"]) == ("as I say", 3)
    assert env.step(np.array([0.0, 9.0, 0.0]))[2:4] == (False, True)


def test_the_reward_is_that_of_the_goals_it_returns_alone_and_in_batches() -> None:
    env, _ = point_masses(kappa=0.0)
    achieved, goals, rewards, infos = [], [], [], []
    for seed in range(40):
        env.reset(seed=seed)
        for _ in range(3):
            observation, reward, *_, info = env.step(env.action_space.sample())
            achieved.append(observation["achieved_goal"])
            goals.append(observation["desired_goal"])
            rewards.append(reward)
            infos.append(info)
            assert reward == env.compute_reward(achieved[-1], goals[-1], info)
    assert {0.0, -1.0} == set(rewards)
    batch = env.compute_reward(np.array(achieved), np.array(goals), infos)
    np.testing.assert_array_equal(batch, rewards)
    distance = np.linalg.norm(np.array(achieved) - np.array(goals), axis=1)
    np.testing.assert_array_equal(batch, np.where(distance < 0.1, 0.0, -1.0))
    assert env.compute_reward(np.zeros((0, 2)), np.zeros((0, 2)), []).shape == (0,)


def test_a_goal_achieved_later_counts_in_all_dimensions_whatever_the_mask() -> None:
    env = scripted()
    *_, info = env.reset(options={"mask": [0, 0, 0]})
    later = np.array([4.0, 4.0, 4.0])
    assert env.compute_reward(later, later, info) == 0.0
    assert env.compute_reward(np.array([4.0, 4.2, 4.0]), later, info) == -1.0


def test_masks_are_drawn_at_each_reset_with_the_samplers_probabilities() -> None:
    env = scripted(c_g=0.3, kappa=2.0)
    env.record_evaluation([[1, 1, 0], [1, 0, 0], [1, 0, 1], [1, 1, 0]])
    env.reset(seed=0)
    masks = np.array([env.reset()[1]["mask"] for _ in range(8000)])
    counts = np.bincount(masks @ [4, 2, 1], minlength=8)
    rates = np.array([1, 0.25, 0.5, 0.125, 1, 0.25, 0.5, 0.125])  # 1, 1/2, 1/4 per dimension
    weights = (1 - np.abs(rates - 0.3)) ** 2
    expected = 8000 * weights / weights.sum()
    assert np.sum((counts - expected) ** 2 / expected) < 24.32  # chi-squared, 7 degrees, 0.1 %


def test_evaluations_decide_which_masks_are_drawn() -> None:
    env = scripted(c_g=0.5, kappa=1000.0)
    env.record_evaluation([[1, 1, 0], [1, 0, 0]])  # rates 1, 1/2, 0: y alone decides for 1/2
    env.reset(seed=0)
    masks = np.array([env.reset()[1]["mask"] for _ in range(300)])
    assert masks[:, 1].all()
    assert not masks[:, 2].any()
    assert masks[:, 0].mean() == pytest.approx(0.5, abs=0.15)
    env.record_evaluation([[1, 1, 1]] * 10)  # all alike, so all masks
    masks = np.array([env.reset()[1]["mask"] for _ in range(300)])
    np.testing.assert_allclose(masks.mean(axis=0), 0.5, atol=0.15)


def test_evaluating_is_the_environment_itself() -> None:
    env, plain = point_masses(kappa=0.0, evaluating=True)
    observation, _ = env.reset(seed=5)
    expected, _ = plain.reset(seed=5)
    for step in range(1, 26):
        for name, value in expected.items():
            np.testing.assert_array_equal(observation[name], value)
        action = env.action_space.sample()
        observation, *results, info = env.step(action)
        expected, *expected_results, _ = plain.step(action)
        assert results == expected_results
        assert info["mask"].all()
        assert info["masked_success"] == info["is_success"] == (results[0] == 0.0)
        assert results[2] == (step == 25)

    env.evaluating = False
    assert not all(env.reset()[1]["mask"].all() for _ in range(50))


def test_the_seed_decides_the_masks_and_leaves_starts_and_goals_as_they_are() -> None:
    (env, plain), (other, _) = point_masses(kappa=0.0), point_masses(kappa=0.0)
    masks = []
    for episode in range(30):
        seed = 3 if episode == 0 else None
        observation, info = env.reset(seed=seed)
        same, same_info = other.reset(seed=seed)
        expected, _ = plain.reset(seed=seed)
        masks.append(info["mask"])
        np.testing.assert_array_equal(info["mask"], same_info["mask"])
        np.testing.assert_array_equal(observation["desired_goal"], same["desired_goal"])
        np.testing.assert_array_equal(observation["observation"], expected["observation"])
        kept = info["mask"]
        np.testing.assert_array_equal(
            observation["desired_goal"][kept], expected["desired_goal"][kept]
        )
        np.testing.assert_array_equal(
            observation["desired_goal"][~kept], expected["achieved_goal"][~kept]
        )
    assert len(np.unique(masks, axis=0)) == 4
    env.reset(seed=4)
    assert (np.array([env.reset()[1]["mask"] for _ in range(29)]) != np.array(masks[1:])).any()


def test_options_other_than_the_mask_reach_the_environment() -> None:
    inner = Scripted()
    env = scripted(inner)
    env.reset(options={"mask": np.ones(3), "start": "here"})
    env.reset(options={"start": "there"})
    env.reset()
    assert inner.options == [{"start": "here"}, {"start": "there"}, None]


@pytest.mark.parametrize("duplicate", [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))])
def test_a_copy_goes_on_alike_and_apart(duplicate: Any) -> None:
    env, _ = point_masses(kappa=1.0)
    env.reset(seed=1)
    env.record_evaluation([1, 0])
    twin = duplicate(env)
    for _ in range(20):
        observation, info = env.reset()
        same, same_info = twin.reset()
        np.testing.assert_array_equal(info["mask"], same_info["mask"])
        np.testing.assert_array_equal(observation["desired_goal"], same["desired_goal"])
    twin.record_evaluation([1, 1])
    np.testing.assert_array_equal(env.sampler.outcomes, [[1, 0]])


def test_masked_goals_lie_in_the_space_of_both_kinds_of_goal() -> None:
    desired = spaces.Box(np.array([-1, -1, 0], np.float32), np.ones(3, np.float32))
    env = scripted(Scripted(desired_goal=desired))
    space = env.observation_space["desired_goal"]
    assert space == spaces.Box(-9.0, 9.0, (3,), np.float64)
    env.reset(options={"mask": [1, 0, 1]})
    observation = env.step(np.array([0.0, 8.5, 0.0]))[0]
    assert observation["desired_goal"] in space
    assert env.observation_space["achieved_goal"] == env.env.observation_space["achieved_goal"]


def test_gymnasiums_own_checker_has_no_complaint_and_make_builds_it_again() -> None:
    gymnasium.register("WrappedPointMass-v0", NumpyPointMass)
    try:
        env = GoalMasking(gymnasium.make("WrappedPointMass-v0"), c_g=0.3)
        with pytest.warns(UserWarning, match="different from the unwrapped version"):
            check_env(env, skip_render_check=True)  # other warnings are errors here
        again: Any = gymnasium.make(env.spec)
        assert isinstance(again, GoalMasking)
        np.testing.assert_array_equal(again.sampler.subgoal_rates, [0.3**0.5] * 2)
    finally:
        del gymnasium.registry["WrappedPointMass-v0"]


@pytest.mark.parametrize("threshold", [None, 0.2, np.float32(0.25), np.array([0.1, 0.2]), [1, 2]])
def test_its_spec_is_written_and_read_and_makes_the_same_again(threshold: Any) -> None:
    env = GoalMasking(
        gymnasium.make("NumpyPointMass-v0"),
        kappa=np.float32(4.0),  # pyright: ignore[reportArgumentType]
        distance_threshold=threshold,
        distance="per_dimension" if np.ndim(threshold) else "euclidean",
        history=np.int64(20),  # pyright: ignore[reportArgumentType]
    )
    assert env.spec is not None
    read = EnvSpec.from_json(env.spec.to_json())
    assert read == env.spec
    again: Any = gymnasium.make(read)
    assert again.spec == env.spec
    np.testing.assert_array_equal(again.rule.threshold, 0.1 if threshold is None else threshold)


def test_the_threshold_is_the_environments_own_unless_one_is_given() -> None:
    inner = NumpyPointMass()
    inner.distance_threshold = 0.25
    assert GoalMasking(inner).rule.threshold == 0.25
    assert GoalMasking(gymnasium.wrappers.TimeLimit(inner, 5)).rule.threshold == 0.25
    assert GoalMasking(inner, distance_threshold=0.5).rule.threshold == 0.5


def box(*shape: int) -> spaces.Box:
    return spaces.Box(-1.0, 1.0, shape, np.float64)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"distance_threshold": None}, "distance_threshold: the environment has no attribute"),
        ({"distance_threshold": 0.0}, "distance_threshold: 0.0 is not finite and above 0"),
        ({"distance_threshold": float("nan")}, "distance_threshold: nan"),
        ({"distance_threshold": "near"}, "distance_threshold: 'near' holds no real numbers"),
        ({"distance_threshold": True}, "distance_threshold: True holds no real numbers"),
        ({"distance_threshold": [0.1, 0.1]}, r"shape \(2,\) is neither \(\) nor \(3,\)"),
        ({"distance_threshold": [0.1] * 3}, 'one per dimension needs distance="per_dimension"'),
        ({"distance": "manhattan"}, "distance: 'manhattan' is none of"),
        ({"c_g": 2.0}, "c_g: 2.0 is not within"),
        ({"env": Scripted(achieved_goal=box(513), desired_goal=box(513))}, "513 dimensions"),
        ({"env": Scripted(achieved_goal=box(2))}, r"shape \(2,\), desired_goal \(3,\)"),
        ({"env": Scripted(desired_goal=box(3, 3))}, "desired_goal is .* not a Box of one axis"),
        ({"env": Scripted(desired_goal=spaces.Discrete(3))}, "desired_goal is Discrete"),
    ],
)
def test_what_cannot_be_masked_is_refused_by_name(arguments: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        scripted(**arguments)


def test_environments_without_goals_are_refused() -> None:
    with pytest.raises(ValueError, match=r"observation_space: Box.* is not a Dict with the goals"):
        GoalMasking(gymnasium.make("Pendulum-v1"))
    inner = Scripted()
    inner.observation_space = spaces.Dict({"observation": box(3), "desired_goal": box(3)})
    with pytest.raises(ValueError, match="observation_space: lacks achieved_goal"):
        scripted(inner)


@pytest.mark.parametrize(
    ("mask", "message"),
    [([1, 0], r"mask: shape \(2,\) is not \(3,\)"), ([1, 0, 2], "something else than 0 and 1")],
)
def test_a_bad_mask_is_refused_before_the_environment_is_reset(mask: Any, message: str) -> None:
    inner = Scripted()
    with pytest.raises(ValueError, match=message):
        scripted(inner).reset(options={"mask": mask})
    assert inner.options == []


def test_a_step_needs_a_reset() -> None:
    with pytest.raises(gymnasium.error.ResetNeeded, match="call reset before step"):
        scripted().step(np.zeros(3))


def test_no_jax_is_needed_to_import_wrap_and_step() -> None:
    program = (
        "import sys, gymnasium\n"
        "from cgm_jax.gymnasium import GoalMasking, VectorGoalMasking\n"
        "from tests.examples.numpy_point_mass import NumpyPointMass\n"
        "env = GoalMasking(NumpyPointMass(), c_g=0.1, kappa=32)\n"
        "env.reset(seed=0)\n"
        "env.step(env.action_space.sample())\n"
        "env.record_evaluation([1, 0])\n"
        "many = VectorGoalMasking(gymnasium.vector.SyncVectorEnv([NumpyPointMass] * 2))\n"
        "many.reset(seed=0)\n"
        "many.step(many.action_space.sample())\n"
        "print(sorted({'jax', 'brax', 'mujoco', 'torch'} & set(sys.modules)))\n"
    )
    result = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert result.stdout == "[]\n", result.stderr


def test_an_environment_that_resets_itself_is_wrapped_from_outside() -> None:
    autoreset = gymnasium.wrappers.Autoreset
    with pytest.raises(ValueError, match="put it around GoalMasking instead"):
        GoalMasking(gymnasium.wrappers.TimeLimit(autoreset(NumpyPointMass()), 100))
    env = autoreset(GoalMasking(NumpyPointMass(), kappa=0.0))
    masks = {tuple(env.reset(seed=0)[1]["mask"])}
    for _ in range(20 * (NumpyPointMass.episode_length + 1)):
        masks.add(tuple(env.step(np.zeros(2))[4]["mask"]))
    assert len(masks) == 4
