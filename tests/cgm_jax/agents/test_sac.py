import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from cgm_jax.agents.gradients import NoisyMinibatch
from cgm_jax.agents.networks import apply_actor, apply_gaussian_actor
from cgm_jax.agents.sac import SAC, SACState, sample
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

AGENT = SAC(hidden_layers=(8, 8), discount=0.9, initial_temperature=0.4)


def example() -> tuple[SACState, NoisyMinibatch]:
    """A state whose targets are other networks, and a minibatch with noise."""
    state, other = (AGENT.init(jax.random.key(i), SIZES) for i in (0, 3))
    state = state.replace(target_critic=other.critic)
    noise, next_noise = jax.random.normal(jax.random.key(2), (2, 16, 2))
    return state, NoisyMinibatch(**vars(example_batch()), noise=noise, next_noise=next_noise)


def sampled(actor: object, inputs: np.ndarray, noise: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Squashed Gaussian actions and the logarithm of their density, from the textbook's formula."""
    mean, log_std = np.split(perceptron(actor, inputs), 2, axis=-1)
    std = np.exp(np.clip(log_std, -20.0, 2.0))
    before = mean + std * noise
    gaussian = np.exp(-0.5 * ((before - mean) / std) ** 2) / (std * np.sqrt(2.0 * np.pi))
    slope = 1.0 / np.cosh(before) ** 2  # of tanh
    return np.tanh(before), np.log(gaussian / slope).sum(axis=-1)


def test_the_density_of_actions_matches_numpy_and_integrates_to_one() -> None:
    state, batch = example()
    assert batch.noise is not None
    inputs, noise = in_numpy((batch.inputs, batch.noise))
    action, log_probability = sample(state.actor, batch.inputs, batch.noise)
    expected, expected_log = sampled(in_numpy(state.actor), inputs, noise)
    np.testing.assert_allclose(action, expected, rtol=1e-4, atol=1e-6)
    np.testing.assert_allclose(log_probability, expected_log, rtol=1e-4, atol=1e-5)
    # One dimension of action on a fine grid: the integral over [-1, 1] by trapezoids.
    actor = SAC(hidden_layers=(4,)).init(jax.random.key(1), SIZES._replace(action=1)).actor
    grid = jnp.linspace(-12.0, 12.0, 20001)[:, None]
    inputs = jnp.broadcast_to(batch.inputs[:1], (len(grid), 3))
    action, log_probability = (np.asarray(x, np.float64) for x in sample(actor, inputs, grid))
    assert np.trapezoid(np.exp(log_probability), action[:, 0]) == pytest.approx(1.0, abs=1e-3)


def test_the_density_is_finite_where_actions_saturate() -> None:
    state, batch = example()
    assert batch.noise is not None
    huge = jax.tree.map(lambda leaf: 1e3 * leaf, state.actor)
    action, log_probability = sample(huge, batch.inputs, batch.noise)
    assert float(jnp.abs(action).max()) == 1.0
    assert bool(jnp.isfinite(log_probability).all())
    _, log_std = apply_gaussian_actor(huge, batch.inputs)
    assert (float(log_std.min()), float(log_std.max())) == (-20.0, 2.0)


def test_losses_match_numpy() -> None:
    state, batch = example()
    numbers = in_numpy(state)
    inputs, action, reward, next_inputs, next_noise, noise = in_numpy(jax.tree.leaves(batch))
    next_action, next_log = sampled(numbers.actor, next_inputs, next_noise)
    both = [action_value(critic, next_inputs, next_action) for critic in numbers.target_critic]
    assert (both[0] < both[1]).any()
    assert (both[0] > both[1]).any()
    target = reward + 0.9 * (np.minimum(*both) - 0.4 * next_log)
    assert (np.abs(target) < 3.0).all()  # no clip is at work
    values = [action_value(critic, inputs, action) for critic in numbers.critic]
    losses = [np.mean((target - value) ** 2) for value in values]
    loss, info = AGENT.critic_loss(state.critic, state, batch)
    assert float(loss) == pytest.approx(sum(losses), rel=1e-4)
    assert float(info["critic_loss"]) == pytest.approx(sum(losses) / 2, rel=1e-4)

    action, log_probability = sampled(numbers.actor, inputs, noise)
    both = [action_value(critic, inputs, action) for critic in numbers.critic]
    loss, info = AGENT.actor_loss(state.actor, state, batch)
    expected = np.mean(0.4 * log_probability - np.minimum(*both))
    assert float(loss) == pytest.approx(expected, rel=1e-4)
    assert float(info["entropy"]) == pytest.approx(-log_probability.mean(), rel=1e-4)
    assert float(info["temperature"]) == pytest.approx(0.4, rel=1e-5)

    slope = jax.grad(AGENT.temperature_loss)(state.log_temperature, info["entropy"], 2)
    assert float(slope) == pytest.approx(-np.mean(log_probability - 2.0), rel=1e-4)


@pytest.mark.parametrize(("reward", "end"), [(-1e3, -1.0), (1e3, 0.0)])
def test_targets_are_clipped_to_what_soft_returns_can_be(reward: float, end: float) -> None:
    state, batch = example()
    batch = batch.replace(reward=jnp.full(16, reward))
    _, info = AGENT.critic_loss(state.critic, state, batch)
    value = AGENT.value(state, batch.inputs, batch.action)
    # By hand: each step earns `end`, and each but the first the entropy of uniform actions.
    target = 10.0 * (end + 0.9 * 0.4 * 2 * np.log(2.0))
    expected = jnp.mean(jnp.square(value - target))
    assert float(info["critic_loss"]) == pytest.approx(float(expected), rel=1e-5)


@pytest.mark.parametrize(("reward", "end"), [(-1e3, -10.0), (1e3, 36.0 * 2 * np.log(2.0))])
def test_where_episodes_end_targets_reach_from_no_entropy_to_all_of_it(
    reward: float, end: float
) -> None:
    agent = dataclasses.replace(AGENT, initial_temperature=4.0)
    state, batch = example()
    state = state.replace(log_temperature=jnp.log(jnp.float32(4.0)))
    continues = jnp.arange(16) % 2.0
    batch = batch.replace(reward=jnp.full(16, reward), continues=continues)
    _, info = agent.critic_loss(state.critic, state, batch)
    value = agent.value(state, batch.inputs, batch.action)
    # By hand: 0.9 / (1 - 0.9) * 4 * 2 log 2 of entropy is to come, or none after the last step.
    target = np.where(continues > 0, end, np.clip(reward, -10.0, 0.0))
    expected = np.mean(np.square(np.asarray(value) - target))
    assert float(info["critic_loss"]) == pytest.approx(float(expected), rel=1e-5)


def test_where_episodes_end_targets_do_not_reckon_with_entropy_to_come() -> None:
    state, batch = example()
    state = state.replace(
        log_temperature=jnp.log(jnp.float32(2.0)),
        target_critic=jax.tree.map(jnp.zeros_like, state.target_critic),
    )
    batch = batch.replace(continues=jnp.ones(16))
    _, info = AGENT.critic_loss(state.critic, state, batch)
    next_inputs, next_noise, reward = in_numpy((batch.next_inputs, batch.next_noise, batch.reward))
    _, next_log = sampled(in_numpy(state.actor), next_inputs, next_noise)
    target = reward - 0.9 * 2.0 * next_log
    # If all the entropy were to come, 24.9, no target would be below 14.9.
    assert ((target > -10.0) & (target < 14.0)).all()
    value = np.asarray(AGENT.value(state, batch.inputs, batch.action))
    expected = np.mean(np.square(value - target))
    assert float(info["critic_loss"]) == pytest.approx(float(expected), rel=1e-4)


@pytest.mark.parametrize(("target", "sign"), [(-5.0, -1), (5.0, 1)])
def test_the_temperature_falls_where_there_is_too_much_entropy_and_rises_where_too_little(
    target: float, sign: int
) -> None:
    agent = dataclasses.replace(AGENT, target_entropy=target, temperature_learning_rate=0.01)
    state, batch = example()
    updated, _ = update(agent, state, batch)
    change = float(updated.log_temperature - state.log_temperature)
    assert change == pytest.approx(0.01 * sign, rel=1e-3)  # Adam's first step


def test_what_entropy_is_aimed_at_matters_only_where_the_temperature_learns() -> None:
    state, _ = example()
    batches = example_batch(4, seed=1)

    def trained(agent: SAC) -> tuple[object, ...]:
        after, _ = train(agent, state, batches, jax.random.key(0))
        return after.actor, after.critic, after.log_temperature

    lazy, eager = (
        dataclasses.replace(AGENT, temperature_learning_rate=rate) for rate in (0.0, 0.01)
    )
    results = [
        jax.tree.map(np.asarray, trained(dataclasses.replace(agent, target_entropy=target)))
        for agent in (lazy, eager)
        for target in (-3.0, 3.0)
    ]
    assert_equal(results[0], results[1])
    assert results[2][2] < results[3][2]
    assert lazy.idle() == {"target_entropy"}
    assert eager.idle() == frozenset()


def test_critics_learn_at_every_update_and_the_actor_at_every_third() -> None:
    agent = dataclasses.replace(AGENT, actor_update_every=3)
    state, batch = example()
    once, _ = update_critic(agent, state, batch)
    for name in ("actor", "log_temperature", "actor_optimiser", "temperature_optimiser"):
        assert_equal(getattr(once, name), getattr(state, name))
    moved = jax.tree.map(lambda x, y: 0.005 * x + 0.995 * y, once.critic, state.target_critic)
    assert_close(once.target_critic, moved)
    trained, losses = train(agent, state, example_batch(6, seed=1), jax.random.key(5))
    assert {name: value.shape for name, value in losses.items()} == dict.fromkeys(
        agent.logged, (2,)
    )
    assert int(trained.updates) == 6
    assert int(trained.actor_optimiser.count) == 2  # pyright: ignore
    assert int(trained.critic_optimiser.count) == 6  # pyright: ignore


def test_it_explores_by_sampling_and_is_evaluated_by_its_mean() -> None:
    state, batch = example()
    inputs = batch.inputs
    mean, log_std = apply_gaussian_actor(state.actor, inputs)
    np.testing.assert_allclose(AGENT.act(state, inputs), jnp.tanh(mean), rtol=1e-6)
    np.testing.assert_allclose(apply_actor(AGENT.actor(state), inputs), jnp.tanh(mean), rtol=1e-5)
    keys = jax.random.split(jax.random.key(4), 20_000)
    drawn = jax.vmap(lambda key: jnp.arctanh(AGENT.act(state, inputs[0], key)))(keys)
    np.testing.assert_allclose(drawn.mean(0), mean[0], atol=0.03)
    np.testing.assert_allclose(drawn.std(0), jnp.exp(log_std[0]), rtol=0.03)
