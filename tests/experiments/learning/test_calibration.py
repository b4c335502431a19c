import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from cgm_jax.agents.ddpg import DDPG
from cgm_jax.config.settings import Hyperparameters, Settings
from cgm_jax.loop.training import make_trainer
from cgm_jax.storage.policies import policy_arrays
from experiments.learning.calibration import success_per_mask
from experiments.learning.calibration_errors import calibration_errors
from tests.cgm_jax.probe import OneStepProbe, actor_that_needs_to_see_y


def test_estimates_know_the_full_goal_and_measurements_the_masked_one() -> None:
    env = OneStepProbe((1.0,), goal_size=2, action_size=2)
    small = Settings(env="probe", environments=1, replay_transitions=10)
    state = make_trainer(env, small).init(Hyperparameters(agent=DDPG(hidden_layers=(16, 16))))
    actor = actor_that_needs_to_see_y(state.agent.actor)
    arrays = policy_arrays(*jax.tree.map(np.asarray, (actor, state.normaliser)))
    arrays = jax.tree.map(jnp.asarray, arrays)
    always_random = Hyperparameters(random_action_probability=1.0)
    measure = jax.jit(functools.partial(success_per_mask, env))
    rates = measure(arrays, always_random, jax.random.key(0))
    np.testing.assert_allclose(rates["product"], [1, 1, 1, 1])
    np.testing.assert_allclose(rates["joint"], [1, 1, 1, 1])
    np.testing.assert_allclose(rates["without_noise"], [1, 1, 0, 1])  # none, y, x, x and y
    # Random signs of two actions: each is right half of the time, in 100 episodes.
    np.testing.assert_allclose(rates["with_noise"], [1, 0.5, 0.5, 0.25], atol=0.2)


def test_the_joint_rate_is_that_of_all_kept_sub_goals_at_once() -> None:
    """A policy that always does 1, where each of two goals is 1 or -1: half of each, a quarter."""
    env = OneStepProbe((1.0, -1.0), goal_size=2, action_size=2)
    small = Settings(env="probe", environments=1, replay_transitions=10)
    state = make_trainer(env, small).init(Hyperparameters(agent=DDPG(hidden_layers=(16, 16))))
    actor = jax.tree.map(jnp.zeros_like, state.agent.actor)
    actor["params"]["layer_2"]["bias"] += 1.0
    arrays = policy_arrays(*jax.tree.map(np.asarray, (actor, state.normaliser)))
    measure = jax.jit(functools.partial(success_per_mask, env))
    rates = measure(jax.tree.map(jnp.asarray, arrays), Hyperparameters(), jax.random.key(0))
    for estimate in ("product", "joint", "without_noise"):
        np.testing.assert_allclose(rates[estimate], [1, 0.5, 0.5, 0.25], atol=0.2)


def test_errors_are_mean_distance_and_mean_difference() -> None:
    rows = [
        {"kept": "x", "product": 0.5, "joint": 0.5, "without_noise": 0.4, "with_noise": 0.5},
        {"kept": "y", "product": 0.2, "joint": 0.4, "without_noise": 0.5, "with_noise": 0.5},
        {"kept": "x y", "product": 0.1, "joint": 0.9, "without_noise": 0.9, "with_noise": 0.4},
    ]
    table = calibration_errors(rows)
    assert table["product", "without_noise"] == pytest.approx((0.2, -0.1))
    assert table["joint", "without_noise"] == pytest.approx((0.1, 0.0))
