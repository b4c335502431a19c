"""Running mean and standard deviation of what the networks see.

The statistics are Brax's; this module decides what feeds them. One NaN row would poison them
for good, so rows of dropped episodes get no weight and a harmless value.
"""

import jax
import jax.numpy as jnp
from brax.training.acme import running_statistics
from brax.training.acme.running_statistics import RunningStatisticsState
from flax import struct

from cgm_jax.replay import Episodes

LEAST_STANDARD_DEVIATION = 0.01
GREATEST_RAW_VALUE = 200.0
GREATEST_NORMALISED_VALUE = 5.0


class Normaliser(struct.PyTreeNode):
    """Statistics of observations and of goals."""

    observation: RunningStatisticsState
    goal: RunningStatisticsState


def initial_normaliser(observation_size: int, goal_size: int) -> Normaliser:
    """Statistics that have seen nothing: mean 0, standard deviation 1."""
    return Normaliser(
        observation=_blank(observation_size),
        goal=_blank(goal_size),
    )


def observe(normaliser: Normaliser, episodes: Episodes, valid: jax.Array) -> Normaliser:
    """Take in the valid ones [episodes] of new episodes.

    Goals are fed from both kinds that the networks see: desired and achieved ones.
    """
    length = episodes.action.shape[1]
    desired = jnp.repeat(episodes.desired_goal[:, None], length, axis=1)
    goals = jnp.concatenate([desired, episodes.achieved_goal[:, 1:]], axis=1)
    return Normaliser(
        observation=_update(normaliser.observation, episodes.observation, valid),
        goal=_update(normaliser.goal, goals, valid),
    )


def network_input(normaliser: Normaliser, observation: jax.Array, goal: jax.Array) -> jax.Array:
    """Normalised observation and goal, [..., observation_size + goal_size]."""
    return jnp.concatenate(
        [_normalise(normaliser.observation, observation), _normalise(normaliser.goal, goal)],
        axis=-1,
    )


def _blank(size: int) -> RunningStatisticsState:
    # The default std_eps is a Python number, whose weak type would not survive the first epoch
    # and would make the second one compile anew.
    return running_statistics.init_state(jnp.zeros(size), std_eps=jnp.zeros(()))  # pyright: ignore


def _normalise(statistics: RunningStatisticsState, rows: jax.Array) -> jax.Array:
    rows = jnp.clip(rows, -GREATEST_RAW_VALUE, GREATEST_RAW_VALUE)
    return running_statistics.normalize(rows, statistics, GREATEST_NORMALISED_VALUE)


def _update(
    statistics: RunningStatisticsState, rows: jax.Array, valid: jax.Array
) -> RunningStatisticsState:
    """Update with rows [episodes, steps, size] of the valid episodes [episodes]."""
    rows = jnp.clip(rows, -GREATEST_RAW_VALUE, GREATEST_RAW_VALUE)
    usable = jnp.broadcast_to(valid[:, None], rows.shape[:2]) & jnp.isfinite(rows).all(axis=-1)
    updated = running_statistics.update(
        statistics,
        jnp.where(usable[..., None], rows, 0.0),
        weights=usable.astype(jnp.float32),
        std_min_value=LEAST_STANDARD_DEVIATION,
    )
    # With no row at all the update divides by a count of zero.
    return jax.tree.map(
        lambda new, old: jnp.where(usable.any(), new, old).astype(jnp.asarray(old).dtype),
        updated,
        statistics,
    )
