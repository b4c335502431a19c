"""Everything that training carries from step to step, for one run."""

import dataclasses
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from cgm_jax.agents.ddpg import Agent
from cgm_jax.agents.normaliser import Normaliser
from cgm_jax.config.settings import Hyperparameters, check
from cgm_jax.curricula.masking import SuccessHistory
from cgm_jax.replay.ring import Replay

# All of them are traced; settings.py itself stays free of JAX.
_NAMES = [field.name for field in dataclasses.fields(Hyperparameters)]
jax.tree_util.register_dataclass(Hyperparameters, data_fields=_NAMES, meta_fields=[])


def stack(runs: Sequence[Hyperparameters]) -> Hyperparameters:
    """Hyperparameters of several runs as one pytree, every leaf [runs].

    Types are fixed per field (int32, float32, bool), whatever the values, so that two grids of
    the same length compile to the same program.

    Raises:
        SettingError: a value of another type, not finite, or out of its range.
    """
    for run in runs:
        check(run)
    kinds = {int: np.int32, float: np.float32, bool: np.bool_}
    leaves: dict[str, Any] = {}
    for field in dataclasses.fields(Hyperparameters):
        values = [getattr(run, field.name) for run in runs]
        leaves[field.name] = jnp.asarray(np.array(values, kinds[type(field.default)]))
    return Hyperparameters(**leaves)


class EpochStatistics(struct.PyTreeNode):
    """Sums over the training of one epoch.

    Attributes:
        mask_episodes: training episodes per mask, [2^n].
        mask_successes: those that achieved their masked goal, [2^n].
        moved_episodes: those that moved their achieved goal (`relabelling.moved_goal`), scalar.
        physics_warnings: episodes dropped, scalar.
        losses: sums of the scalars that `DDPG.update` returns.
        updates: how many updates of both networks they are sums of, scalar.
    """

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
        agent, normaliser, replay: see their modules.
        history: outcomes of evaluation rollouts with the full goal, per sub-goal.
        mask_history: outcomes of those with masked goals, per mask; empty unless
            `masked_evaluation_episodes` asks for some.
        statistics: of the epoch in progress.
        env_steps: training steps over all environments so far, int32.
        failure: 0, or what has diverged, see `divergence.failure_of`; then the agent is frozen.
    """

    key: jax.Array
    agent: Agent
    normaliser: Normaliser
    replay: Replay
    history: SuccessHistory
    mask_history: SuccessHistory
    statistics: EpochStatistics
    env_steps: jax.Array
    failure: jax.Array


LOSSES = ("critic_loss", "actor_loss", "value")


def empty_statistics(masks: int) -> EpochStatistics:
    """Statistics at the start of an epoch, for a goal with this many masks."""
    return EpochStatistics(
        mask_episodes=jnp.zeros(masks),
        mask_successes=jnp.zeros(masks),
        moved_episodes=jnp.zeros(()),
        physics_warnings=jnp.zeros(()),
        losses={name: jnp.zeros(()) for name in LOSSES},
        updates=jnp.zeros(()),
    )
