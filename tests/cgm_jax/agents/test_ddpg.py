import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from cgm_jax.agents.ddpg import DDPG, Agent, Minibatch
from cgm_jax.config.settings import Hyperparameters
from cgm_jax.loop.normaliser import network_input
from cgm_jax.loop.state import TrainingState
from cgm_jax.loop.training import Trainer
from tests.cgm_jax.probe import TINY, OneStepProbe

PLAIN = Hyperparameters(cgm=False, her=False, discount=0.5, target_rate=0.1, action_penalty=0.0)


def trained(goals: tuple[float, ...], hyper: Hyperparameters) -> tuple[Trainer, TrainingState]:
    settings = dataclasses.replace(TINY, updates_per_cycle=40, replay_transitions=1000)
    trainer = Trainer(OneStepProbe(goals), settings)
    # The evaluation tells the curriculum which goals are out of reach.
    state, _ = jax.jit(trainer.evaluate)(trainer.initial_state(hyper), hyper)
    return trainer, jax.jit(trainer.train_cycles)(state, hyper, 40)


def values(trainer: Trainer, state: TrainingState, goal: float, action: float) -> float:
    inputs = network_input(state.normaliser, jnp.ones(1), jnp.full(1, goal))
    return float(trainer.ddpg.value(state.agent.critic, inputs, jnp.full(1, action)))


def test_values_of_reachable_goals_are_those_of_the_optimal_policy() -> None:
    trainer, state = trained((1.0, -1.0), PLAIN)
    for goal in (1.0, -1.0):
        # The optimum goes on to reach the goal for ever: 0; one detour costs one reward.
        assert values(trainer, state, goal, goal) == pytest.approx(0.0, abs=0.1)
        assert values(trainer, state, goal, -goal) == pytest.approx(-1.0, abs=0.1)
        inputs = network_input(state.normaliser, jnp.ones(1), jnp.full(1, goal))
        assert float(trainer.ddpg.act(state.agent.actor, inputs)[0]) * goal > 0.5


def test_values_of_an_unreachable_goal_are_the_geometric_sum() -> None:
    trainer, state = trained((5.0,), PLAIN)
    for action in (-1.0, 0.3, 1.0):
        assert values(trainer, state, 5.0, action) == pytest.approx(-2.0, abs=0.1)


def test_masked_goals_are_always_achieved() -> None:
    # c_g = 1 makes the all-zero mask the only likely one, under which every reward is 0; the
    # goal that the networks see is then the achieved one, 0 before the step and +-1 after it.
    trainer, state = trained((5.0,), dataclasses.replace(PLAIN, cgm=True, c_g=1.0, kappa=1e6))
    assert values(trainer, state, 0.0, 1.0) == pytest.approx(0.0, abs=0.1)
    assert values(trainer, state, 0.0, -1.0) == pytest.approx(0.0, abs=0.1)


def perceptron(parameters: dict[str, dict[str, np.ndarray]], inputs: np.ndarray) -> np.ndarray:
    layers = [parameters[f"layer_{i}"] for i in range(len(parameters))]
    for layer in layers[:-1]:
        inputs = np.maximum(inputs @ layer["kernel"] + layer["bias"], 0.0)
    return inputs @ layers[-1]["kernel"] + layers[-1]["bias"]


def example() -> tuple[DDPG, Agent, Minibatch]:
    ddpg = DDPG(input_size=3, action_size=2, hidden_layers=(8, 8), target_update_every=2)
    agent, other = (ddpg.initial_agent(jax.random.key(i)) for i in (0, 1))
    agent = agent.replace(target_actor=other.actor, target_critic=other.critic)
    generator = np.random.default_rng(0)
    batch = Minibatch(
        inputs=jnp.asarray(generator.normal(size=(16, 3)), jnp.float32),
        action=jnp.asarray(generator.uniform(-1, 1, (16, 2)), jnp.float32),
        reward=jnp.asarray(-generator.integers(0, 2, 16), jnp.float32),
        next_inputs=jnp.asarray(generator.normal(size=(16, 3)), jnp.float32),
    )
    return ddpg, agent, batch


def test_losses_match_numpy() -> None:
    ddpg, agent, batch = example()
    hyper = Hyperparameters(discount=0.9, action_penalty=0.3)
    actor, critic, target_actor, target_critic = (
        jax.tree.map(np.asarray, getattr(agent, name)["params"])
        for name in ("actor", "critic", "target_actor", "target_critic")
    )
    inputs, next_inputs = np.asarray(batch.inputs), np.asarray(batch.next_inputs)
    next_action = np.tanh(perceptron(target_actor, next_inputs))
    next_value = perceptron(target_critic, np.concatenate([next_inputs, next_action], -1))[:, 0]
    target = np.clip(np.asarray(batch.reward) + 0.9 * next_value, -10.0, 0.0)
    assert (target == 0.0).any()  # the clip is at work
    value = perceptron(critic, np.concatenate([inputs, np.asarray(batch.action)], -1))[:, 0]
    loss, _ = ddpg.critic_loss(agent.critic, agent, batch, hyper)
    assert float(loss) == pytest.approx(np.mean((target - value) ** 2), rel=1e-5)

    action = np.tanh(perceptron(actor, inputs))
    value = perceptron(critic, np.concatenate([inputs, action], -1))[:, 0]
    loss, _ = ddpg.actor_loss(agent.actor, agent, batch, hyper)
    assert float(loss) == pytest.approx(-value.mean() + 0.3 * np.mean(action**2), rel=1e-5)


def test_targets_move_only_when_due_and_by_their_rate() -> None:
    ddpg, agent, batch = example()
    hyper = Hyperparameters(target_rate=0.25)
    first, _ = ddpg.update(agent, batch, hyper)
    np.testing.assert_array_equal(
        *(one.target_critic["params"]["layer_0"]["kernel"] for one in (first, agent))
    )
    second, _ = ddpg.update(first, batch, hyper)
    for name in ("actor", "critic"):
        new, target, old_target = (
            getattr(state, prefix + name)["params"]["layer_1"]["kernel"]
            for state, prefix in ((second, ""), (second, "target_"), (first, "target_"))
        )
        np.testing.assert_allclose(target, 0.25 * new + 0.75 * old_target, rtol=1e-5)


def test_adams_first_step_is_the_learning_rate() -> None:
    ddpg, agent, batch = example()
    hyper = Hyperparameters(actor_learning_rate=0.01, critic_learning_rate=0.002)
    updated, _ = ddpg.update(agent, batch, hyper)
    for name, rate in (("actor", 0.01), ("critic", 0.002)):
        change = jax.tree.map(
            lambda a, b: jnp.abs(a - b).max(), getattr(updated, name), getattr(agent, name)
        )
        assert max(float(leaf) for leaf in jax.tree.leaves(change)) == pytest.approx(rate, rel=1e-3)


def test_an_update_of_the_critic_alone_leaves_the_actor_and_counts() -> None:
    ddpg, agent, batch = example()
    agent = agent.replace(updates=jnp.asarray(1, jnp.int32))  # targets move with the next one
    hyper = Hyperparameters(target_rate=0.25)
    alone, info = ddpg.update_critic(agent, batch, hyper)
    both, full_info = ddpg.update(agent, batch, hyper)
    for name in ("critic", "critic_optimiser", "target_critic", "updates"):
        jax.tree.map(np.testing.assert_array_equal, getattr(alone, name), getattr(both, name))
    for name in ("actor", "actor_optimiser"):
        jax.tree.map(np.testing.assert_array_equal, getattr(alone, name), getattr(agent, name))
    np.testing.assert_allclose(
        alone.target_actor["params"]["layer_0"]["kernel"],
        0.25 * agent.actor["params"]["layer_0"]["kernel"]
        + 0.75 * agent.target_actor["params"]["layer_0"]["kernel"],
        rtol=1e-5,
    )
    assert info.keys() == full_info.keys() - {"actor_loss"}


def test_the_actor_follows_the_critic_from_before_the_update() -> None:
    ddpg, agent, batch = example()
    hyper = Hyperparameters()
    once, _ = ddpg.update(agent, batch, hyper)
    twice, _ = ddpg.update(once, batch, hyper)
    gradient = jax.grad(ddpg.actor_loss, has_aux=True)(once.actor, once, batch, hyper)[0]
    moment, before = (
        state.actor_optimiser.mu["params"]["layer_0"]["kernel"]  # pyright: ignore
        for state in (twice, once)
    )
    expected = 0.9 * before + 0.1 * gradient["params"]["layer_0"]["kernel"]
    np.testing.assert_allclose(moment, expected, rtol=1e-4, atol=1e-7)


def test_training_takes_the_minibatches_in_turn_and_the_actor_every_third() -> None:
    ddpg, agent, _ = example()
    ddpg, hyper = dataclasses.replace(ddpg, actor_update_every=3), Hyperparameters()
    generator = np.random.default_rng(1)
    batches = Minibatch(
        *(jnp.asarray(generator.normal(size=(6, 16, *size)), jnp.float32) for size in SIZES)
    )
    trained, losses = ddpg.train(agent, batches, hyper)
    expected, logged = agent, []
    for i in range(6):
        batch = jax.tree.map(lambda rows, i=i: rows[i], batches)
        update = ddpg.update if i in (2, 5) else ddpg.update_critic
        expected, info = update(expected, batch, hyper)
        logged += [info] if i in (2, 5) else []
    for one, other in zip(jax.tree.leaves(trained), jax.tree.leaves(expected), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-4, atol=1e-6)
    for name, values in losses.items():
        np.testing.assert_allclose(values, [info[name] for info in logged], rtol=1e-4)


SIZES = [(3,), (2,), (), (3,)]
"""Of an example's inputs, action, reward and next inputs."""
