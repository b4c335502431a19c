import jax
import jax.numpy as jnp
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


def test_shapes_are_those_that_the_annotations_tell() -> None:
    critics = tuple(init_critic(key, (8,), 3, 2) for key in jax.random.split(KEY, 3))
    assert apply_critic(critics[0], INPUTS, ACTION).shape == (5, 4)
    assert apply_critics(critics, INPUTS, ACTION).shape == (3, 5, 4)
    gaussian = init_gaussian_actor(KEY, (8,), 3, 2)
    mean, log_std = apply_gaussian_actor(gaussian, INPUTS)
    assert mean.shape == log_std.shape == (5, 4, 2)
    assert apply_actor(mean_actor(gaussian), INPUTS).shape == (5, 4, 2)


def test_annotations_are_checked_in_tests() -> None:
    actor, critic = init_actor(KEY, (8,), 3, 2), init_critic(KEY, (8,), 3, 2)
    with pytest.raises(TypeCheckError, match="apply_critic"):
        apply_critic(critic, INPUTS, ACTION[0])  # which broadcasts without a word elsewhere
    with pytest.raises(TypeCheckError, match="apply_actor"):
        apply_actor(actor, jnp.ones((5, 3), jnp.int32))
