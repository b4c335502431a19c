"""Values that agents learn, where they are known."""

import dataclasses
import math
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from cgm_jax.agents.gradients import return_limits
from cgm_jax.config.grid import hyperparameters
from cgm_jax.config.settings import Hyperparameters
from cgm_jax.loop.normaliser import network_input
from cgm_jax.loop.state import TrainingState
from cgm_jax.loop.training import make_trainer
from tests.cgm_jax.agents.trained import AGENTS
from tests.cgm_jax.probe import TINY, OneStepProbe

PLAIN = {
    "her": False,
    "discount": 0.5,
    "target_rate": 0.1,
    "target_update_every": 1,
    "hidden_layers": (16, 16),
}
OWN = {
    "ddpg": {"action_penalty": 0.0},
    "td3": {"action_penalty": 0.0},
    "sac": {"initial_temperature": 1e-4, "temperature_learning_rate": 0.0},
}
"""Without entropy, SAC's values are those of the others."""


def settings_of(agent: str, **values: Any) -> Hyperparameters:
    return hyperparameters(
        **{**PLAIN, **OWN[agent], "curriculum": "full", "agent": agent, **values}
    )


SETTINGS = dataclasses.replace(TINY, updates_per_cycle=40, replay_transitions=1000)


@jax.jit
def trained(hyper: Hyperparameters, goals: jax.Array) -> TrainingState:
    """A run on goals [2], of which 1 and -1 are within reach; one program for all goals."""
    trainer = make_trainer(OneStepProbe(goals), SETTINGS)  # pyright: ignore[reportArgumentType]
    # The evaluation tells the curriculum which goals are out of reach.
    state, _ = trainer.evaluate(trainer.init(hyper), hyper)
    return trainer.train(state, hyper, 40)


REACHABLE, UNREACHABLE = jnp.array([1.0, -1.0]), jnp.array([5.0, 5.0])


def inputs_of(state: TrainingState, goal: float) -> jax.Array:
    return network_input(state.normaliser, jnp.ones(1), jnp.full(1, goal))


def values(state: TrainingState, hyper: Hyperparameters, goal: float, action: float) -> np.ndarray:
    """Of each critic."""
    return np.asarray(hyper.agent.value(state.agent, inputs_of(state, goal), jnp.full(1, action)))


@pytest.mark.parametrize("agent", AGENTS)
def test_values_of_reachable_goals_are_those_of_the_optimal_policy(agent: str) -> None:
    hyper = settings_of(agent)
    state = trained(hyper, REACHABLE)
    for goal in (1.0, -1.0):
        # The optimum continues to reach the goal for ever: 0; one detour costs one reward.
        np.testing.assert_allclose(values(state, hyper, goal, goal), 0.0, atol=0.1)
        np.testing.assert_allclose(values(state, hyper, goal, -goal), -1.0, atol=0.1)
        assert float(hyper.agent.act(state.agent, inputs_of(state, goal))[0]) * goal > 0.5


@pytest.mark.parametrize("agent", AGENTS)
def test_values_of_an_unreachable_goal_are_the_geometric_sum(agent: str) -> None:
    hyper = settings_of(agent)
    state = trained(hyper, UNREACHABLE)
    for action in (-1.0, 0.3, 1.0):
        np.testing.assert_allclose(values(state, hyper, 5.0, action), -2.0, atol=0.1)


def test_masked_goals_are_always_achieved() -> None:
    # c_g = 1 makes the all-zero mask the only likely one, under which every reward is 0; the
    # goal that the networks see is then the achieved one, 0 before the step and +-1 after it.
    hyper = settings_of("ddpg", curriculum="cgm", c_g=1.0, kappa=1e6)
    state = trained(hyper, UNREACHABLE)
    np.testing.assert_allclose(values(state, hyper, 0.0, 1.0), 0.0, atol=0.1)
    np.testing.assert_allclose(values(state, hyper, 0.0, -1.0), 0.0, atol=0.1)


def test_soft_values_of_an_unreachable_goal_hold_the_entropy_of_actions_at_random() -> None:
    hyper = settings_of("sac", initial_temperature=1.0)
    state = trained(hyper, UNREACHABLE)
    # Nothing tells actions apart, so that the best policy has the most entropy: a bit less than a
    # uniform one's log 2, since it squashes a Gaussian. Every step but the first earns it.
    expected = -2.0 + 0.5 / (1.0 - 0.5) * math.log(2.0)
    for action in (-1.0, 0.3, 1.0):
        np.testing.assert_allclose(values(state, hyper, 5.0, action), expected, atol=0.1)
    keys = jax.random.split(jax.random.key(1), 4000)
    inputs = inputs_of(state, 5.0)
    actions = jax.vmap(lambda key: hyper.agent.act(state.agent, inputs, key))(keys)[:, 0]
    # Uniform actions in [-1, 1] have mean 0 and standard deviation 3^(-1/2).
    assert float(actions.mean()) == pytest.approx(0.0, abs=0.1)
    assert float(actions.std()) == pytest.approx(3**-0.5, abs=0.1)


@pytest.mark.parametrize(
    ("rewards", "limits"), [((0.5, 2.0), (0.0, 20.0)), ((-3.0, -1.0), (-30.0, 0.0))]
)
def test_returns_of_episodes_that_end_reach_from_or_to_zero(
    rewards: tuple[float, float], limits: tuple[float, float]
) -> None:
    assert return_limits(0.9, rewards) == pytest.approx(limits)
