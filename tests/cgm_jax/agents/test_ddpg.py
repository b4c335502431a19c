import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest

from cgm_jax.agents.ddpg import DDPG, DDPGState
from cgm_jax.agents.networks import Actor, Critic
from cgm_jax.agents.protocol import Minibatch
from tests.cgm_jax.agents.oracle import (
    SIZES,
    action_value,
    assert_close,
    assert_equal,
    example_batch,
    in_numpy,
    perceptron,
    train,
    update,
    update_critic,
)

TWICE = DDPG(hidden_layers=(8, 8), target_update_every=2)
"""Its targets move at every second update."""


def example(ddpg: DDPG = TWICE) -> tuple[DDPGState, Minibatch]:
    """A state whose targets are other networks, and a minibatch."""
    state, other = (ddpg.init(jax.random.key(i), SIZES) for i in (0, 1))
    state = state.replace(target_actor=other.actor, target_critic=other.critic)
    return state, example_batch()


def test_losses_match_numpy() -> None:
    ddpg = dataclasses.replace(TWICE, discount=0.9, action_penalty=0.3)
    state, batch = example()
    numbers = in_numpy(state)
    inputs, action, reward, next_inputs = in_numpy(jax.tree.leaves(batch))
    next_action = np.tanh(perceptron(numbers.target_actor, next_inputs))
    next_value = action_value(numbers.target_critic[0], next_inputs, next_action)
    target = np.clip(reward + 0.9 * next_value, -10.0, 0.0)
    assert (target == 0.0).any()  # the clip is at work
    value = action_value(numbers.critic[0], inputs, action)
    loss, _ = ddpg.critic_loss(state.critic, state, batch)
    assert float(loss) == pytest.approx(np.mean((target - value) ** 2), rel=1e-5)

    action = np.tanh(perceptron(numbers.actor, inputs))
    value = action_value(numbers.critic[0], inputs, action)
    loss, _ = ddpg.actor_loss(state.actor, state, batch)
    assert float(loss) == pytest.approx(-value.mean() + 0.3 * np.mean(action**2), rel=1e-5)


def test_targets_move_only_when_due_and_by_their_rate() -> None:
    ddpg = dataclasses.replace(TWICE, target_rate=0.25)
    state, batch = example()
    first, _ = update(ddpg, state, batch)
    assert_equal(first.target_critic, state.target_critic)
    second, _ = update(ddpg, first, batch)
    for name in ("actor", "critic"):
        new, target, old_target = (
            getattr(state, prefix + name)
            for state, prefix in ((second, ""), (second, "target_"), (first, "target_"))
        )
        assert_close(target, jax.tree.map(lambda x, y: 0.25 * x + 0.75 * y, new, old_target))


def test_adams_first_step_is_the_learning_rate() -> None:
    ddpg = dataclasses.replace(TWICE, actor_learning_rate=0.01, critic_learning_rate=0.002)
    state, batch = example()
    updated, _ = update(ddpg, state, batch)
    for name, rate in (("actor", 0.01), ("critic", 0.002)):
        change = jax.tree.map(
            lambda a, b: jnp.abs(a - b).max(), getattr(updated, name), getattr(state, name)
        )
        assert max(float(leaf) for leaf in jax.tree.leaves(change)) == pytest.approx(rate, rel=1e-3)


def test_an_update_of_the_critic_alone_leaves_the_actor_and_counts() -> None:
    ddpg = dataclasses.replace(TWICE, target_rate=0.25)
    state, batch = example()
    state = state.replace(updates=jnp.asarray(1, jnp.int32))  # targets move with the next one
    alone, info = update_critic(ddpg, state, batch)
    both, full_info = update(ddpg, state, batch)
    for name in ("critic", "critic_optimiser", "target_critic", "updates"):
        assert_equal(getattr(alone, name), getattr(both, name))
    for name in ("actor", "actor_optimiser"):
        assert_equal(getattr(alone, name), getattr(state, name))
    moved = jax.tree.map(lambda x, y: 0.25 * x + 0.75 * y, state.actor, state.target_actor)
    assert_close(alone.target_actor, moved)
    assert info.keys() == full_info.keys() - {"actor_loss"}


def test_the_actor_follows_the_critic_from_before_the_update() -> None:
    state, batch = example()
    once, _ = update(TWICE, state, batch)
    twice, _ = update(TWICE, once, batch)
    gradient = jax.grad(TWICE.actor_loss, has_aux=True)(once.actor, once, batch)[0]
    moment, before = (
        state.actor_optimiser.mu["params"]["layer_0"]["kernel"]  # pyright: ignore
        for state in (twice, once)
    )
    expected = 0.9 * before + 0.1 * gradient["params"]["layer_0"]["kernel"]
    np.testing.assert_allclose(moment, expected, rtol=1e-4, atol=1e-7)


def test_training_takes_the_minibatches_in_turn_and_the_actor_every_third() -> None:
    ddpg = dataclasses.replace(TWICE, actor_update_every=3)
    state, _ = example()
    batches = example_batch(6, seed=1)
    trained, losses = train(ddpg, state, batches, jax.random.key(2))
    expected, logged = state, []
    for i in range(6):
        batch = jax.tree.map(lambda rows, i=i: rows[i], batches)
        expected, info = (update if i in (2, 5) else update_critic)(ddpg, expected, batch)
        logged += [info] if i in (2, 5) else []
    assert_close(trained, expected)
    assert set(losses) == set(ddpg.logged)
    for name, values in losses.items():
        np.testing.assert_allclose(values, [info[name] for info in logged], rtol=1e-4)


def test_each_of_several_critics_learns_as_if_alone_and_the_actor_climbs_their_mean() -> None:
    three = dataclasses.replace(TWICE, critics=3)
    state, batch = example(three)
    loss, info = three.critic_loss(state.critic, state, batch)
    trained, _ = update_critic(three, state, batch)
    alone, values = [], []
    for i in range(3):
        only = {name: getattr(state, name)[i : i + 1] for name in ("critic", "target_critic")}
        own = state.replace(**only, critic_optimiser=optax.scale_by_adam().init(only["critic"]))
        updated, _ = update_critic(TWICE, own, batch)
        alone += updated.critic
        values.append(TWICE.critic_loss(own.critic, own, batch)[0])
    assert_close(trained.critic, alone)
    assert float(loss) == pytest.approx(float(sum(values)), rel=1e-5)
    assert float(info["critic_loss"]) == pytest.approx(float(sum(values)) / 3, rel=1e-5)
    estimates = three.value(state, batch.inputs, batch.action)
    assert estimates.shape == (3, 16)
    assert float(jnp.abs(estimates[0] - estimates[1]).max()) > 0.01  # of other networks

    action = three.act(state, batch.inputs)
    climbed, _ = three.actor_loss(state.actor, state, batch)
    mean = three.value(state, batch.inputs, action).mean()
    assert float(climbed) == pytest.approx(-float(mean) + float(jnp.mean(action**2)), rel=1e-5)


def test_with_one_critic_every_bit_is_that_of_an_agent_written_for_one() -> None:
    ddpg = dataclasses.replace(TWICE, discount=0.9, target_rate=0.3, target_update_every=1)
    state, batch = example(ddpg)
    trained, info = jax.jit(ddpg.update)(state, batch)
    single = {name: getattr(state, name) for name in ("actor", "target_actor", "actor_optimiser")}
    single |= {name: getattr(state, name)[0] for name in ("critic", "target_critic")}
    single["critic_optimiser"] = optax.scale_by_adam().init(single["critic"])
    networks, losses = jax.jit(update_of_one_critic)(single, batch)
    for name, network in networks.items():
        assert_equal(getattr(trained, name), network)
    for name, value in losses.items():
        assert_equal(info[name], value)


def update_of_one_critic(networks: dict[str, Any], batch: Minibatch) -> tuple[Any, Any]:
    """DDPG's first update as its paper has it: no tuple of critics, nothing summed over them."""
    actor, critic = Actor((8, 8), 2), Critic((8, 8))

    def actor_loss(parameters: Any) -> Any:
        action: Any = actor.apply(parameters, batch.inputs)
        value: Any = critic.apply(networks["critic"], batch.inputs, action)
        return -jnp.mean(value) + 1.0 * jnp.mean(jnp.square(action))

    def critic_loss(parameters: Any) -> Any:
        next_action: Any = actor.apply(networks["target_actor"], batch.next_inputs)
        next_value: Any = critic.apply(networks["target_critic"], batch.next_inputs, next_action)
        target = jnp.clip(batch.reward + 0.9 * next_value, -1.0 / (1.0 - 0.9), 0.0)
        value: Any = critic.apply(parameters, batch.inputs, batch.action)
        return jnp.mean(jnp.square(jax.lax.stop_gradient(target) - value)), value.mean()

    adam, new, losses = optax.scale_by_adam(), {}, {}
    losses["actor_loss"], slope = jax.value_and_grad(actor_loss)(networks["actor"])
    (losses["critic_loss"], losses["value"]), climb = jax.value_and_grad(critic_loss, has_aux=True)(
        networks["critic"]
    )
    for name, gradient in (("actor", slope), ("critic", climb)):
        direction, _ = adam.update(gradient, networks[f"{name}_optimiser"])
        step = jax.tree.map(lambda leaf: -1e-3 * leaf, direction)
        new[name] = optax.apply_updates(networks[name], step)
        target = networks[f"target_{name}"]
        new[f"target_{name}"] = optax.incremental_update(new[name], target, 0.3)
    return {name: (new[name],) if "critic" in name else new[name] for name in new}, losses
