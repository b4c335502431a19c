"""Shapes of the actor and the critic, and how their parameters are made and applied."""

from collections.abc import Sequence
from typing import Any

import flax.linen as nn
import jax
import jax.numpy as jnp

Parameters = Any


class Actor(nn.Module):
    """A deterministic policy: normalised observation and goal to an action in [-1, 1].

    Attributes:
        hidden_layers: widths of the ReLU layers.
        action_size: number of action dimensions.
    """

    hidden_layers: Sequence[int]
    action_size: int

    @nn.compact
    def __call__(self, inputs: jax.Array) -> jax.Array:
        """The action [..., action_size] for inputs [..., input_size]."""
        return nn.tanh(_perceptron(inputs, self.hidden_layers, self.action_size))


class Critic(nn.Module):
    """An action-value function: normalised observation, goal and action to a return [...].

    Attributes:
        hidden_layers: widths of the ReLU layers.
    """

    hidden_layers: Sequence[int]

    @nn.compact
    def __call__(self, inputs: jax.Array, action: jax.Array) -> jax.Array:
        """The value [...] of action [..., action_size] in inputs [..., input_size]."""
        inputs = jnp.concatenate([inputs, action], axis=-1)
        return _perceptron(inputs, self.hidden_layers, 1)[..., 0]


def initial_actor(
    key: jax.Array, hidden_layers: Sequence[int], inputs: int, actions: int
) -> Parameters:
    """Parameters of an actor for so many inputs and action dimensions."""
    return Actor(hidden_layers, actions).init(key, jnp.zeros(inputs))


def initial_critic(
    key: jax.Array, hidden_layers: Sequence[int], inputs: int, actions: int
) -> Parameters:
    """Parameters of a critic for so many inputs and action dimensions."""
    return Critic(hidden_layers).init(key, jnp.zeros(inputs), jnp.zeros(actions))


def apply_actor(parameters: Parameters, inputs: jax.Array) -> jax.Array:
    """The action [..., action_size] of an actor for inputs [..., input_size]."""
    *hidden, actions = _widths(parameters)
    return Actor(hidden, actions).apply(parameters, inputs)  # pyright: ignore[reportReturnType]


def apply_critic(parameters: Parameters, inputs: jax.Array, action: jax.Array) -> jax.Array:
    """A critic's estimate [...] of the return of actions in inputs."""
    hidden = _widths(parameters)[:-1]
    return Critic(hidden).apply(parameters, inputs, action)  # pyright: ignore[reportReturnType]


def _widths(parameters: Parameters) -> list[int]:
    layers = parameters["params"]
    return [layers[f"layer_{i}"]["bias"].shape[-1] for i in range(len(layers))]


def _perceptron(inputs: jax.Array, hidden_layers: Sequence[int], output_size: int) -> jax.Array:
    """Dense layers named layer_0, layer_1, ...; called inside a module's compact method."""
    initialiser = nn.initializers.glorot_uniform()
    widths = [*hidden_layers, output_size]
    for i, width in enumerate(widths):
        inputs = nn.Dense(width, kernel_init=initialiser, name=f"layer_{i}")(inputs)
        if i < len(hidden_layers):
            inputs = nn.relu(inputs)
    return inputs
