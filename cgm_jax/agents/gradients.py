"""Gradient steps, target networks and rounds of updates, as every agent here takes them."""

from collections.abc import Callable
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import optax
from jaxtyping import Array, Float

from cgm_jax.agents.protocol import Info, Minibatch, Parameters
from cgm_jax.config.fields import SettingError
from cgm_jax.config.sizes import Sizes

State = TypeVar("State")
Update = Callable[[State, Any], tuple[State, dict[str, jax.Array]]]
"""From an agent's state and a minibatch to the state after it and scalars to log."""

# Without its step size, which is traced and differs between runs.
ADAM = optax.scale_by_adam()


def descend(
    parameters: Parameters,
    gradient: Parameters,
    optimiser: optax.OptState,
    learning_rate: float | jax.Array,
) -> tuple[Parameters, optax.OptState]:
    """One step of Adam: new parameters, and the optimiser's new state."""
    with jax.numpy_dtype_promotion("standard"):  # Optax has JAX turn its count into a float
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


def clip_return(
    value: jax.Array,
    discount: float | jax.Array,
    reward_range: tuple[float, float] = (-1.0, 0.0),
) -> jax.Array:
    """A value clipped to what a return can be, see `return_limits`."""
    return jnp.clip(value, *return_limits(discount, reward_range))


def return_limits(
    discount: float | jax.Array, reward_range: tuple[float, float] = (-1.0, 0.0)
) -> tuple[float | jax.Array, float | jax.Array]:
    """Least and greatest return: with rewards of -1 or 0 for ever -1 / (1 - gamma) and 0.

    With early ends a return lies between 0, of an episode that is over, and that of one which goes
    on for ever.
    """
    low, high = min(reward_range[0], 0.0), max(reward_range[1], 0.0)
    return low / (1.0 - discount), high / (1.0 - discount)


class NoisyMinibatch(Minibatch, kw_only=True):
    """Transitions with standard normal noise for actions in their states.

    Attributes:
        next_noise: for actions in the next states, [..., action].
        noise: for actions in the present ones, alike; None for an agent that takes none.
    """

    next_noise: jax.Array
    noise: jax.Array | None = None


def critic_errors(
    value: Float[Array, "critics batch"], target: Float[Array, " batch"]
) -> tuple[Float[Array, ""], Info]:
    """The loss of critics that share a target: mean squared errors, summed over critics.

    Args:
        value: what each critic says, [critics, batch].
        target: [batch]; no gradient flows through it.

    Returns:
        The loss, and scalars to log: critic_loss and value, means over critics.
    """
    losses = jnp.mean(jnp.square(jax.lax.stop_gradient(target) - value), axis=-1)
    return losses.sum(), {"critic_loss": losses.mean(), "value": value.mean()}


def train_in_rounds(
    state: State, batches: Any, every: int, update_critic: Update[State], update: Update[State]
) -> tuple[State, dict[str, jax.Array]]:
    """One update per minibatch, every `every`-th of them of all networks.

    Args:
        state: of the agent.
        batches: minibatches [updates, batch, ...]; `every` divides the updates.
        every: minibatches in a round.
        update_critic: of all minibatches of a round but the last.
        update: of the last.

    Returns:
        The state, and what `update` returned in each round, [updates / every].
    """

    def train_round(state: State, batches: Any) -> tuple[State, dict[str, jax.Array]]:
        if every > 1:
            for_critic = jax.tree.map(lambda rows: rows[:-1], batches)
            state, _ = jax.lax.scan(update_critic, state, for_critic)
        return update(state, jax.tree.map(lambda rows: rows[-1], batches))

    rounds = jax.tree.map(lambda rows: rows.reshape(-1, every, *rows.shape[1:]), batches)
    return jax.lax.scan(train_round, state, rounds)


def check_rounds(actor_update_every: int, sizes: Sizes) -> None:
    """Check that updates come in whole rounds, of which the last is also the actor's.

    Raises:
        SettingError: they do not.
    """
    if sizes.updates_at_once % actor_update_every:
        raise SettingError(
            f"actor_update_every: {actor_update_every} does not divide "
            f"updates_per_cycle, {sizes.updates_at_once}"
        )
