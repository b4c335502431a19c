"""What a way to relabel offers to the loop: minibatches of transitions from the replay ring.

It is a class of settings (see `config/fields.py`) with one pure function of one run, which the loop
vmaps over runs, the settings included.
"""

from typing import Protocol, runtime_checkable

import jax
from flax import struct

from cgm_jax.replay.ring import Replay


class Transitions(struct.PyTreeNode):
    """Transitions as the networks see them: goals are masked, rewards recomputed.

    Attributes:
        observation, next_observation: [..., observation_size].
        goal, next_goal: masked with the achieved goal of their own step, [..., n].
        mask: [..., n].
        threshold: the goal is achieved closer than this, [...].
        action: [..., action_size].
        reward: 0 where the next state achieves the masked goal, else -1; [...]. Where the
            environment has a rule of its own the loop puts that in its place.
        next_achieved: the goal achieved in the next state, [..., n].
        continues: 0 where the next state is terminal, else 1; [...]. None where the environment
            ends no episodes (`Episodes.length`).
    """

    observation: jax.Array
    goal: jax.Array
    mask: jax.Array
    threshold: jax.Array
    action: jax.Array
    reward: jax.Array
    next_observation: jax.Array
    next_goal: jax.Array
    next_achieved: jax.Array | None = None
    continues: jax.Array | None = None


@runtime_checkable
class Relabelling(Protocol):
    """A way to draw transitions and to choose their goals."""

    def sample(
        self, key: jax.Array, replay: Replay, count: int, distance_threshold: float
    ) -> Transitions:
        """Draw transitions.

        Args:
            key: consumed.
            replay: holds at least one episode.
            count: how many.
            distance_threshold: of the environment.
        """
        ...

    def idle(self) -> frozenset[str]:
        """Names of settings that have no effect, given the others; for concrete values only."""
        return frozenset()


PROTOCOL = Relabelling
