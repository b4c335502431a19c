"""Gradient steps and target networks, as every agent here takes them."""

from typing import Any

import jax
import jax.numpy as jnp
import optax

Parameters = Any

# Without its step size, which is traced and differs between runs.
ADAM = optax.scale_by_adam()


def descend(
    parameters: Parameters,
    gradient: Parameters,
    optimiser: optax.OptState,
    learning_rate: float | jax.Array,
) -> tuple[Parameters, optax.OptState]:
    """One step of Adam: new parameters, and the optimiser's new state."""
    direction, optimiser = ADAM.update(gradient, optimiser)
    step = jax.tree.map(lambda leaf: -learning_rate * leaf, direction)
    return optax.apply_updates(parameters, step), optimiser


def follow(
    networks: Parameters,
    targets: Parameters,
    updates: jax.Array,
    every: int,
    rate: float | jax.Array,
) -> Parameters:
    """Polyak averaging: targets move towards the networks after every `every`-th update.

    Args:
        networks: any pytree of parameters.
        targets: the same structure.
        updates: how many updates there have been, this one included; int32 scalar.
        every: updates between moves.
        rate: share of the way that they move.
    """
    rate = jnp.where(updates % every == 0, rate, 0.0)
    return optax.incremental_update(networks, targets, rate)


def clip_return(value: jax.Array, discount: float | jax.Array) -> jax.Array:
    """What a return can be where rewards are -1 or 0 for ever: within [-1 / (1 - gamma), 0]."""
    return jnp.clip(value, -1.0 / (1.0 - discount), 0.0)


def in_rounds(batches: Any, every: int) -> Any:
    """Minibatches [updates, ...] as rounds [updates / every, every, ...]."""
    return jax.tree.map(lambda rows: rows.reshape(-1, every, *rows.shape[1:]), batches)
