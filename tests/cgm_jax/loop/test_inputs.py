"""What networks are told: masks, thresholds, and noise only where the agent does not explore."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np

from cgm_jax.agents.networks import apply_actor
from cgm_jax.curricula.protocol import Goals
from cgm_jax.loop.cycle import training_policy, view_of
from cgm_jax.loop.exploration import Exploration
from cgm_jax.loop.inputs import network_inputs
from cgm_jax.loop.learning import minibatches
from cgm_jax.loop.normaliser import network_input
from cgm_jax.loop.training import make_trainer
from cgm_jax.storage.policies import act, policy_arrays
from tests.cgm_jax.probe import TINY, tiny
from tests.examples.point_mass import PointMass

TRAINER = make_trainer(PointMass(), TINY)
MASKED = make_trainer(PointMass(), dataclasses.replace(TINY, mask_input=True))
OBSERVATION = jnp.asarray(np.random.default_rng(0).normal(size=(3, 4)), jnp.float32)
GOAL = jnp.array([[0.5, -0.5], [0.1, 0.2], [-0.9, 0.3]])


def test_networks_see_which_dimensions_are_masked_and_of_the_full_goal_nothing() -> None:
    hyper = tiny()
    state = MASKED.init(hyper)
    mask = jnp.array([[1.0, 1.0], [0.0, 1.0], [1.0, 0.0]])
    inputs = network_inputs(
        MASKED.setup, hyper, state.normaliser, OBSERVATION, GOAL, mask, jnp.ones(3)
    )
    np.testing.assert_array_equal(inputs[:, -2:], [[0, 0], [1, 0], [0, 1]])


def test_a_policy_file_that_sees_masks_acts_as_its_actor_under_each() -> None:
    hyper = tiny()
    state = MASKED.init(hyper)
    actor = hyper.agent.actor(state.agent)
    arrays = policy_arrays(actor, state.normaliser, mask_input=True)
    seen = network_input(state.normaliser, OBSERVATION, GOAL)
    for mask in ([1.0, 1.0], [0.0, 1.0], [1.0, 0.0]):
        told = jnp.broadcast_to(1.0 - jnp.array(mask), (3, 2))
        expected = apply_actor(actor, jnp.concatenate([seen, told], axis=-1))
        np.testing.assert_allclose(
            act(arrays, OBSERVATION, GOAL, np.array(mask, np.float32)), expected, atol=1e-6
        )
    np.testing.assert_allclose(
        act(arrays, OBSERVATION, GOAL),
        act(arrays, OBSERVATION, GOAL, np.ones(2, np.float32)),
        atol=1e-6,
    )


def test_curricula_ask_critics_about_whole_goals() -> None:
    hyper = tiny()
    state = MASKED.init(hyper)
    view = view_of(MASKED.setup, state, hyper, None)
    seen = network_input(state.normaliser, OBSERVATION, GOAL)
    inputs = jnp.concatenate([seen, jnp.zeros((3, 2))], axis=-1)
    expected = hyper.agent.value(state.agent, inputs, hyper.agent.act(state.agent, inputs))
    np.testing.assert_allclose(view.value(OBSERVATION, GOAL), expected, rtol=1e-5)


def quiet(count: int) -> Exploration:
    """No noise, for so many episodes."""
    zeros = jnp.zeros((count, 2))
    return Exploration(zeros, zeros, jnp.zeros((count, 1), bool))


def test_exploration_sees_the_threshold_of_its_episodes() -> None:
    hyper = tiny(curriculum="accuracy")
    state = TRAINER.init(hyper)
    goals = Goals(GOAL, jnp.ones((3, 2)), jnp.array([0.1, 0.2, 0.25]))
    policy = training_policy(TRAINER.setup, state, hyper, goals)
    told = jnp.log(jnp.array([1.0, 2.0, 2.5]))[:, None]
    seen = jnp.concatenate([network_input(state.normaliser, OBSERVATION, GOAL), told], axis=-1)
    expected = apply_actor(state.agent.actor, seen)
    np.testing.assert_allclose(policy(OBSERVATION, GOAL, quiet(3)), expected, atol=1e-6)


def test_updates_see_the_threshold_of_the_episodes_that_they_replay() -> None:
    hyper = tiny(curriculum="accuracy")
    state = TRAINER.init(hyper)
    replay = state.replay
    episodes = replay.episodes.replace(threshold=jnp.full_like(replay.episodes.threshold, 0.25))
    state = state.replace(replay=replay.replace(episodes=episodes, inserted=jnp.int32(8)))
    batch = minibatches(TRAINER.setup, state, hyper, jax.random.key(0))
    for inputs in (batch.inputs, batch.next_inputs):
        np.testing.assert_allclose(inputs[..., -1], np.log(2.5), rtol=1e-6)


def test_an_agent_that_explores_by_itself_gets_no_gaussian_noise() -> None:
    hyper = tiny(agent="sac")
    state = TRAINER.init(hyper)
    goals = Goals(GOAL, jnp.ones((3, 2)), jnp.full(3, 0.1))
    noise = quiet(3).replace(perturbation=jnp.full((3, 2), 5.0), key=jax.random.key(1))
    action = training_policy(TRAINER.setup, state, hyper, goals)(OBSERVATION, GOAL, noise)
    inputs = network_input(state.normaliser, OBSERVATION, GOAL)
    np.testing.assert_allclose(
        action, hyper.agent.act(state.agent, inputs, jax.random.key(1)), atol=1e-6
    )
