"""Everything that training carries from step to step, for one run."""

from typing import Any

import jax
import jax.numpy as jnp
from flax import struct

from cgm_jax.loop.normaliser import Normaliser
from cgm_jax.replay.ring import Replay


class EpochStatistics(struct.PyTreeNode):
    """Sums over the training of one epoch.

    Attributes:
        episodes: training episodes that count, scalar.
        mask_episodes: those per mask, [2^n], or [0] where that is too many.
        mask_successes: those that achieved their masked goal, alike.
        moved_episodes: those that moved their achieved goal (`future.moved_goal`), scalar.
        physics_warnings: episodes dropped since their physics broke, scalar.
        losses: sums of the scalars that `Agent.train` returns.
        updates: how many of each they are sums of, scalar.
    """

    episodes: jax.Array
    mask_episodes: jax.Array
    mask_successes: jax.Array
    moved_episodes: jax.Array
    physics_warnings: jax.Array
    losses: dict[str, jax.Array]
    updates: jax.Array


class TrainingState(struct.PyTreeNode):
    """State of one run; under a sweep every leaf has a leading axis of runs.

    Attributes:
        key: source of all further randomness.
        agent, curriculum: what only they know the structure of.
        normaliser, replay: see their modules.
        statistics: of the epoch in progress.
        env_steps: training steps over all environments so far, int32; all episodes count with their
            whole length T, also those that ended early or were dropped.
        updates: minibatches that the agent was given, int32; stands still once it failed.
        failure: 0, or what has diverged, see `divergence.failure_of`; then the agent is frozen.
        unfinished: of a cycle that is cut, see `parts.py`; None where cycles are whole.
    """

    key: jax.Array
    agent: Any
    curriculum: Any
    normaliser: Normaliser
    replay: Replay
    statistics: EpochStatistics
    env_steps: jax.Array
    updates: jax.Array
    failure: jax.Array
    unfinished: Any = None


def init_statistics(masks: int, logged: tuple[str, ...]) -> EpochStatistics:
    """Statistics at the start of an epoch.

    Args:
        masks: how many masks are told apart.
        logged: names of what the agent logs.
    """
    return EpochStatistics(
        episodes=jnp.zeros(()),
        mask_episodes=jnp.zeros(masks),
        mask_successes=jnp.zeros(masks),
        moved_episodes=jnp.zeros(()),
        physics_warnings=jnp.zeros(()),
        losses={name: jnp.zeros(()) for name in logged},
        updates=jnp.zeros(()),
    )


def count_true(condition: jax.Array, axis: int | None = None) -> jax.Array:
    """How many entries are true, of all or along an axis, as statistics count: float32."""
    return jnp.sum(condition, axis, dtype=jnp.float32)
