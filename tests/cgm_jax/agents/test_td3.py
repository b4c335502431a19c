import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from cgm_jax.agents.ddpg import DDPGState
from cgm_jax.agents.gradients import NoisyMinibatch
from cgm_jax.agents.td3 import TD3
from tests.cgm_jax.agents.oracle import (
    SIZES,
    action_value,
    assert_equal,
    example_batch,
    in_numpy,
    perceptron,
    train,
    update_critic,
)

AGENT = TD3(hidden_layers=(8, 8), discount=0.9, target_noise=0.6, action_penalty=0.3)


def example() -> tuple[DDPGState, NoisyMinibatch]:
    """A state whose targets are other networks, and a minibatch with noise."""
    state, other = (AGENT.init(jax.random.key(i), SIZES) for i in (0, 3))
    state = state.replace(target_actor=other.actor, target_critic=other.critic)
    noise = jax.random.normal(jax.random.key(2), (16, 2))
    return state, NoisyMinibatch(**vars(example_batch()), next_noise=noise)


def test_losses_match_numpy() -> None:
    state, batch = example()
    numbers = in_numpy(state)
    inputs, action, reward, next_inputs, noise = in_numpy(jax.tree.leaves(batch))
    noise = np.clip(0.6 * noise, -0.5, 0.5)
    assert (np.abs(noise) == 0.5).any()  # the noise's clip is at work
    next_action = np.tanh(perceptron(numbers.target_actor, next_inputs)) + noise
    assert (np.abs(next_action) > 1.0).any()  # and so is the action's
    next_action = np.clip(next_action, -1.0, 1.0)
    both = [action_value(critic, next_inputs, next_action) for critic in numbers.target_critic]
    assert (both[0] < both[1]).any()
    assert (both[0] > both[1]).any()
    target = np.clip(reward + 0.9 * np.minimum(*both), -10.0, 0.0)
    assert (target == 0.0).any()  # so is the return's
    values = [action_value(critic, inputs, action) for critic in numbers.critic]
    losses = [np.mean((target - value) ** 2) for value in values]
    loss, info = AGENT.critic_loss(state.critic, state, batch)
    assert float(loss) == pytest.approx(sum(losses), rel=1e-5)
    assert float(info["critic_loss"]) == pytest.approx(sum(losses) / 2, rel=1e-5)
    assert float(info["value"]) == pytest.approx(np.mean(values), rel=1e-5)

    action = np.tanh(perceptron(numbers.actor, inputs))
    value = action_value(numbers.critic[0], inputs, action)
    loss, _ = AGENT.actor_loss(state.actor, state, batch)
    assert float(loss) == pytest.approx(-value.mean() + 0.3 * np.mean(action**2), rel=1e-5)


def test_actor_and_targets_wait_for_every_second_update() -> None:
    state, _ = example()
    batches = example_batch(2, seed=1)
    first = NoisyMinibatch(
        **vars(jax.tree.map(lambda rows: rows[0], batches)), next_noise=jnp.ones(2)
    )
    once, _ = update_critic(AGENT, state, first)
    for name in ("actor", "target_actor", "target_critic"):
        assert_equal(getattr(once, name), getattr(state, name))
    trained, losses = train(AGENT, state, batches, jax.random.key(5))
    for name in ("actor", "critic", "target_actor", "target_critic"):
        for x, y in zip(
            jax.tree.leaves(getattr(trained, name)),
            jax.tree.leaves(getattr(state, name)),
            strict=True,
        ):
            assert not np.array_equal(x, y), name
    assert {name: value.shape for name, value in losses.items()} == dict.fromkeys(
        AGENT.logged, (1,)
    )


def test_noise_differs_between_keys_and_without_it_keys_do_not_matter() -> None:
    state, _ = example()
    batches = example_batch(4, seed=1)

    def critic(agent: TD3, seed: int) -> jax.Array:
        trained, _ = train(agent, state, batches, jax.random.key(seed))
        return trained.critic[0]["params"]["layer_0"]["kernel"]

    quiet = dataclasses.replace(AGENT, target_noise=0.0)
    assert (critic(AGENT, 0) != critic(AGENT, 1)).any()
    np.testing.assert_array_equal(critic(quiet, 0), critic(quiet, 1))
    assert quiet.idle() == {"target_noise_clip"}
    cut = dataclasses.replace(AGENT, target_noise_clip=0.0)
    louder = dataclasses.replace(cut, target_noise=0.9)
    np.testing.assert_array_equal(critic(cut, 0), critic(louder, 0))
    assert cut.idle() == {"target_noise"}
    assert not AGENT.idle()
