"""Shapes of the actor and the critic."""

from collections.abc import Sequence

import flax.linen as nn
import jax
import jax.numpy as jnp


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


def _perceptron(inputs: jax.Array, hidden_layers: Sequence[int], output_size: int) -> jax.Array:
    """Dense layers named layer_0, layer_1, ...; called inside a module's compact method."""
    initialiser = nn.initializers.glorot_uniform()
    widths = [*hidden_layers, output_size]
    for i, width in enumerate(widths):
        inputs = nn.Dense(width, kernel_init=initialiser, name=f"layer_{i}")(inputs)
        if i < len(hidden_layers):
            inputs = nn.relu(inputs)
    return inputs
