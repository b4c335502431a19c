"""Shapes of actors and critics, and how their parameters are made and applied."""

from collections.abc import Callable, Sequence
from typing import Any

import flax.linen as nn
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from cgm_jax.agents.products import product
from cgm_jax.agents.protocol import Parameters
from cgm_jax.config.sizes import Sizes

LOG_STD = (-20.0, 2.0)
"""Limits of the logarithm of a Gaussian actor's standard deviation, Haarnoja's."""


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


class GaussianActor(nn.Module):
    """A stochastic policy: the Gaussian that `tanh` squashes into an action.

    Its last layer gives the means, then the logarithms of the standard deviations.

    Attributes:
        hidden_layers: widths of the ReLU layers.
        action_size: number of action dimensions.
    """

    hidden_layers: Sequence[int]
    action_size: int

    @nn.compact
    def __call__(self, inputs: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Means and logarithms of standard deviations, each [..., action_size]."""
        outputs = _perceptron(inputs, self.hidden_layers, 2 * self.action_size)
        mean, log_std = jnp.split(outputs, 2, axis=-1)
        return mean, jnp.clip(log_std, *LOG_STD)


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


def init_actor(
    key: jax.Array, hidden_layers: Sequence[int], inputs: int, actions: int
) -> Parameters:
    """Parameters of an actor for so many inputs and action dimensions."""
    return Actor(hidden_layers, actions).init(key, jnp.zeros(inputs))


def init_gaussian_actor(
    key: jax.Array, hidden_layers: Sequence[int], inputs: int, actions: int
) -> Parameters:
    """Parameters of a Gaussian actor for so many inputs and action dimensions."""
    return GaussianActor(hidden_layers, actions).init(key, jnp.zeros(inputs))


def init_critic(
    key: jax.Array, hidden_layers: Sequence[int], inputs: int, actions: int
) -> Parameters:
    """Parameters of a critic for so many inputs and action dimensions."""
    return Critic(hidden_layers).init(key, jnp.zeros(inputs), jnp.zeros(actions))


def init_networks(
    key: jax.Array,
    init_actor: Callable[..., Parameters],
    critics: int,
    hidden_layers: Sequence[int],
    sizes: Sizes,
) -> tuple[Parameters, tuple[Parameters, ...]]:
    """Parameters of an actor and of so many critics for a task; the actor's key comes first.

    Args:
        key: consumed.
        init_actor: `init_actor` or `init_gaussian_actor`.
        critics: how many.
        hidden_layers: of all networks.
        sizes: of the task.
    """
    actor_key, *critic_keys = jax.random.split(key, 1 + critics)
    shape = (hidden_layers, sizes.inputs, sizes.action)
    critic = tuple(init_critic(critic_key, *shape) for critic_key in critic_keys)
    return init_actor(actor_key, *shape), critic


def apply_actor(
    parameters: Parameters, inputs: Float[Array, "*batch inputs"]
) -> Float[Array, "*batch action"]:
    """The action [..., action_size] of an actor for inputs [..., input_size]."""
    *hidden, actions = _widths(parameters)
    return Actor(hidden, actions).apply(parameters, inputs)  # pyright: ignore[reportReturnType]


def apply_gaussian_actor(
    parameters: Parameters, inputs: Float[Array, "*batch inputs"]
) -> tuple[Float[Array, "*batch action"], Float[Array, "*batch action"]]:
    """Means and logarithms of standard deviations, each [..., action_size], before `tanh`."""
    *hidden, outputs = _widths(parameters)
    actor = GaussianActor(hidden, outputs // 2)
    return actor.apply(parameters, inputs)  # pyright: ignore[reportReturnType]


def mean_actor(parameters: Parameters) -> Parameters:
    """The `Actor` whose action is that of a Gaussian actor without its noise, tanh(mean)."""
    layers = dict(parameters["params"])
    last = f"layer_{len(layers) - 1}"
    actions = layers[last]["bias"].shape[-1] // 2
    layers[last] = {name: values[..., :actions] for name, values in layers[last].items()}
    return {"params": layers}


def with_mean(gaussian: Parameters, actor: Parameters) -> Parameters:
    """The Gaussian actor whose mean is an `Actor`'s, as `mean_actor` would give it back.

    Args:
        gaussian: has the last layer's weights for standard deviations, which stay.
        actor: has all others.
    """
    layers = dict(actor["params"])
    last = f"layer_{len(layers) - 1}"
    own = gaussian["params"][last]
    layers[last] = {
        name: jnp.concatenate([mean, own[name][..., mean.shape[-1] :]], axis=-1)
        for name, mean in layers[last].items()
    }
    return {"params": layers}


def apply_critic(
    parameters: Parameters,
    inputs: Float[Array, "*batch inputs"],
    action: Float[Array, "*batch action"],
) -> Float[Array, "*batch"]:
    """A critic's estimate [...] of the return of actions in inputs."""
    hidden = _widths(parameters)[:-1]
    return Critic(hidden).apply(parameters, inputs, action)  # pyright: ignore[reportReturnType]


def apply_critics(
    critics: Sequence[Parameters],
    inputs: Float[Array, "*batch inputs"],
    action: Float[Array, "*batch action"],
) -> Float[Array, " critics *batch"]:
    """What each critic expects of actions, [critics, ...]."""
    return jnp.stack([apply_critic(critic, inputs, action) for critic in critics])


def _widths(parameters: Parameters) -> list[int]:
    layers = parameters["params"]
    return [layers[f"layer_{i}"]["bias"].shape[-1] for i in range(len(layers))]


def _perceptron(inputs: jax.Array, hidden_layers: Sequence[int], output_size: int) -> jax.Array:
    """Dense layers named layer_0, layer_1, ...; called inside a module's compact method."""
    initialiser = nn.initializers.glorot_uniform()
    widths = [*hidden_layers, output_size]
    for i, width in enumerate(widths):
        dense = nn.Dense(width, kernel_init=initialiser, dot_general=_product, name=f"layer_{i}")
        inputs = dense(inputs)
        if i < len(hidden_layers):
            inputs = nn.relu(inputs)
    return inputs


def _product(inputs: jax.Array, weights: jax.Array, *_: Any, **__: Any) -> jax.Array:
    """What `nn.Dense` asks of `jax.lax.dot_general`."""
    return product(inputs, weights)
