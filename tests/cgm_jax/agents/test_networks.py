import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import TypeCheckError

from cgm_jax.agents.networks import (
    apply_actor,
    apply_critic,
    apply_critics,
    apply_gaussian_actor,
    init_actor,
    init_critic,
    init_gaussian_actor,
    mean_actor,
)

KEY = jax.random.key(0)
INPUTS, ACTION = jnp.ones((5, 4, 3)), jnp.zeros((5, 4, 2))


def test_several_critics_are_each_and_the_mean_actor_acts_without_noise() -> None:
    critics = tuple(init_critic(key, (8,), 3, 2) for key in jax.random.split(KEY, 3))
    values = apply_critics(critics, INPUTS, ACTION)
    assert values.shape == (3, 5, 4)
    for value, critic in zip(values, critics, strict=True):
        np.testing.assert_array_equal(value, apply_critic(critic, INPUTS, ACTION))
    assert len(set(np.asarray(values[:, 0, 0]).tolist())) == 3
    gaussian = init_gaussian_actor(KEY, (8,), 3, 2)
    mean, log_std = apply_gaussian_actor(gaussian, INPUTS)
    assert mean.shape == log_std.shape == (5, 4, 2)
    np.testing.assert_allclose(
        apply_actor(mean_actor(gaussian), INPUTS), np.tanh(mean), rtol=1e-6, atol=1e-7
    )


def test_annotations_are_checked_in_tests() -> None:
    actor, critic = init_actor(KEY, (8,), 3, 2), init_critic(KEY, (8,), 3, 2)
    with pytest.raises(TypeCheckError, match="apply_critic"):
        apply_critic(critic, INPUTS, ACTION[0])  # which broadcasts without a word elsewhere
    with pytest.raises(TypeCheckError, match="apply_actor"):
        apply_actor(actor, jnp.ones((5, 3), jnp.int32))
