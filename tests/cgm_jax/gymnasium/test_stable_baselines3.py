"""Stable-Baselines3's SAC and HER with `GoalMasking`: `make test-sb3`."""

import csv
import subprocess
import sys
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest

from cgm_jax.gymnasium import GoalMasking
from tests.examples.numpy_point_mass import NumpyPointMass

# Large, and not among the requirements: tests/sb3-requirements.txt.
sb3 = pytest.importorskip("stable_baselines3")

pytestmark = pytest.mark.slow

EVALUATION = """
from stable_baselines3.common.evaluation import evaluate_policy

successes = []


def collect(local, _):
    if local["done"]:
        successes.append(local["info"]["is_success"])


evaluation.reset(seed=1000)
evaluate_policy(model, evaluation, 100, callback=collect)
import sys

assert not {"jax", "brax", "mujoco"} & set(sys.modules)
assert len(env.sampler.outcomes) == 10
print(sum(successes))
"""
"""After the README's lines: how many of 100 episodes with the full goal succeed."""


def train(env: Any, steps: int, callback: Any = None, logger: Any = None, **buffer: Any) -> Any:
    model = sb3.SAC(
        "MultiInputPolicy",
        env,
        replay_buffer_class=sb3.HerReplayBuffer,
        replay_buffer_kwargs=buffer,
        policy_kwargs={"net_arch": [16]},
        buffer_size=2000,
        learning_starts=100,
        batch_size=32,
        train_freq=20,
        seed=0,
    )
    if logger is not None:
        model.set_logger(logger)
    return model.learn(steps, callback)


def transitions(model: Any, hindsight: float) -> dict[str, np.ndarray]:
    """Sampled transitions [500]; either none or all have a goal that was achieved later."""
    model.replay_buffer.her_ratio = hindsight
    sample = model.replay_buffer.sample(500)
    return {
        "goal": sample.observations["desired_goal"].numpy(),
        "achieved": sample.observations["achieved_goal"].numpy(),
        "next_goal": sample.next_observations["desired_goal"].numpy(),
        "next_achieved": sample.next_observations["achieved_goal"].numpy(),
        "reward": sample.rewards.numpy().ravel(),
        "done": sample.dones.numpy().ravel(),
    }


def assert_masked(stored: dict[str, np.ndarray]) -> np.ndarray:
    """Dimensions follow what is achieved (masked) or stay; returns which are kept, [500, n]."""
    follows = stored["goal"] == stored["achieved"]
    follows &= stored["next_goal"] == stored["next_achieved"]
    assert (follows | (stored["next_goal"] == stored["goal"])).all()
    return ~follows


def test_the_readmes_lines_learn_without_jax_in_the_process() -> None:
    readme = (Path(__file__).parents[3] / "README.md").read_text()
    lines = readme.split("<!-- stable-baselines3 -->\n```python\n")[1].split("```")[0]
    result = subprocess.run(
        [sys.executable, "-c", lines + EVALUATION], capture_output=True, text=True, check=False
    )
    assert result.returncode == 0, result.stderr
    assert int(result.stdout.split()[-1]) >= 90


def test_stable_baselines3s_own_checker_has_no_complaint() -> None:
    from stable_baselines3.common.env_checker import check_env  # pyright: ignore

    check_env(GoalMasking(NumpyPointMass(), kappa=0.0))  # warnings are errors here


@pytest.mark.parametrize("copy_info_dict", [False, True])
def test_the_buffer_replays_masked_goals_and_full_ones_in_hindsight(copy_info_dict: bool) -> None:
    envs = [lambda: GoalMasking(NumpyPointMass(), kappa=0.0)] * 2
    model = train(sb3.common.vec_env.DummyVecEnv(envs), 600, copy_info_dict=copy_info_dict)

    real = transitions(model, hindsight=0.0)
    kept = assert_masked(real)
    assert len(np.unique(kept, axis=0)) == 4
    distance = np.linalg.norm(np.where(kept, real["goal"] - real["next_achieved"], 0.0), axis=1)
    np.testing.assert_array_equal(real["reward"], np.where(distance < 0.1, 0.0, -1.0))
    assert real["done"].sum() == 0  # a time limit is no end of the task

    virtual = transitions(model, hindsight=1.0)
    np.testing.assert_array_equal(virtual["goal"], virtual["next_goal"])
    reached = model.replay_buffer.next_observations["achieved_goal"].reshape(-1, 2)
    assert {tuple(goal) for goal in virtual["goal"]} <= {tuple(goal) for goal in reached}
    distance = np.linalg.norm(virtual["goal"] - virtual["next_achieved"], axis=1)
    np.testing.assert_array_equal(virtual["reward"], np.where(distance < 0.1, 0.0, -1.0))
    assert 0.05 < np.mean(virtual["reward"] == 0.0) < 0.95


def test_evaluations_reach_every_training_environment(tmp_path: Path) -> None:
    from stable_baselines3.common.evaluation import evaluate_policy  # pyright: ignore

    from cgm_jax.gymnasium.stable_baselines3 import CurriculumEvalCallback

    def evaluation() -> Any:
        env = sb3.common.monitor.Monitor(GoalMasking(Nearby(), evaluating=True))
        vector = sb3.common.vec_env.DummyVecEnv([lambda: env])
        vector.seed(3)
        return vector

    training = sb3.common.vec_env.DummyVecEnv([lambda: GoalMasking(Nearby(), c_g=0.5, kappa=8)] * 2)
    callback = CurriculumEvalCallback(evaluation(), n_eval_episodes=7, eval_freq=30, verbose=0)
    logger = sb3.common.logger.configure(str(tmp_path), ["csv"])
    # It ends before the first update: one policy throughout.
    model = train(training, 60, callback, logger)
    logger.close()
    outcomes: list[np.ndarray] = []

    def collect(local: dict[str, Any], _: Any) -> None:
        if local["done"]:
            outcomes.append(local["info"]["subgoal_success"])

    evaluate_policy(model, evaluation(), 7, callback=collect)
    assert 0 < np.mean(outcomes) < 1
    samplers = training.get_attr("sampler")
    assert len(samplers) == 2
    for sampler in samplers:
        np.testing.assert_array_equal(sampler.outcomes, outcomes)
    with (tmp_path / "progress.csv").open() as file:
        (row,) = [row for row in csv.DictReader(file) if row["eval/mean_reward"]]
    assert row["time/total_timesteps"] == "60"
    assert float(row["curriculum/subgoal_success_0"]) == np.mean(outcomes, axis=0)[0]
    assert float(row["curriculum/full_goal_probability"]) == samplers[0].probabilities[-1]


class Nearby(NumpyPointMass):
    """An action that hardly moves achieves some sub-goals here."""

    distance_threshold = 0.7


@pytest.mark.parametrize(
    ("training", "evaluation", "arguments", "message"),
    [
        (NumpyPointMass(), "masked", {}, "the training environment is not wrapped in GoalMasking"),
        ("masked", NumpyPointMass(), {}, "the evaluation environment is not wrapped"),
        ("masked", GoalMasking(NumpyPointMass()), {}, "evaluation environment needs evaluating=T"),
        (
            GoalMasking(NumpyPointMass(), evaluating=True),
            "masked",
            {},
            "training environment needs",
        ),
        ("masked", "masked", {"deterministic": False}, "deterministic: the curriculum needs"),
    ],
)
def test_environments_that_cannot_feed_the_curriculum_are_refused(
    training: Any, evaluation: Any, arguments: dict[str, Any], message: str
) -> None:
    from cgm_jax.gymnasium.stable_baselines3 import CurriculumEvalCallback

    if training == "masked":
        training = GoalMasking(NumpyPointMass())
    if evaluation == "masked":
        evaluation = GoalMasking(NumpyPointMass(), evaluating=True)
    with pytest.raises(ValueError, match=message):
        train(training, 1, CurriculumEvalCallback(evaluation, **arguments))


def test_parking_of_highway_env_trains_under_a_rule_per_dimension() -> None:
    """Six dimensions of unlike units, a reward of its own, and episodes that crash."""
    gymnasium.register_envs(pytest.importorskip("highway_env"))
    inner = gymnasium.make("parking-v0", config={"duration": 8})  # 40 steps
    with pytest.raises(ValueError, match="distance_threshold: the environment has no attribute"):
        GoalMasking(inner)
    threshold = np.array([0.02, 0.02, 0.2, 0.2, 0.1, 0.1])  # x, y, velocities, heading
    env = GoalMasking(inner, distance_threshold=threshold, distance="per_dimension", kappa=0.0)
    env.reset(seed=0)
    model = train(env, 400)

    real = transitions(model, hindsight=0.0)
    offset = np.abs(np.where(assert_masked(real), real["goal"] - real["next_achieved"], 0.0))
    expected = np.where((offset < threshold).all(axis=1), 0.0, -1.0)
    np.testing.assert_array_equal(real["reward"], expected)
    assert {0.0, -1.0} == set(expected)

    virtual = transitions(model, hindsight=1.0)
    offset = np.abs(virtual["goal"] - virtual["next_achieved"])
    expected = np.where((offset < threshold).all(axis=1), 0.0, -1.0)
    np.testing.assert_array_equal(virtual["reward"], expected)
    env.close()
