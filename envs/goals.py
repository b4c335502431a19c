"""Goals, masked goals, and when they are achieved (Eppe, Magg and Wermter 2019, section III).

A mask keeps (1) or masks (0) each goal dimension. A masked dimension counts as achieved.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax.typing import ArrayLike


class Sizes(NamedTuple):
    """What a curriculum and an agent may know of the task and the loop when they are made.

    Attributes:
        observation: entries of an observation.
        goal: dimensions of a goal, n.
        action: dimensions of an action.
        inputs: entries of what a network sees: observation, goal, and what else is shown.
        episode_length: steps of an episode, T.
        distance_threshold: a goal is achieved closer than this.
        environments: training episodes per cycle, E.
        evaluation_episodes: noise-free episodes with the full goal per epoch.
        updates_per_cycle: minibatches that `Agent.train` gets at once.
        critics: estimates of the return that the agent's `value` gives.
        starts: a state of the environment without axes as shapes, where an episode can begin in
            one; else None.
    """

    observation: int
    goal: int
    action: int
    inputs: int
    episode_length: int
    distance_threshold: float
    environments: int
    evaluation_episodes: int
    updates_per_cycle: int
    critics: int
    starts: object | None


def apply_mask(goal: jax.Array, mask: jax.Array, achieved_goal: jax.Array) -> jax.Array:
    """Equation 1: kept dimensions of the goal, and the achieved goal in the masked ones.

    Args:
        goal: [..., n].
        mask: 0 or 1, [..., n]; the three broadcast against each other.
        achieved_goal: [..., n].

    Returns:
        [..., n]. Exactly `goal` under the full mask, and free of the goal's masked entries
        even where those are not finite.
    """
    return jnp.where(mask > 0, goal, achieved_goal)


def masked_distance(goal: jax.Array, mask: jax.Array, achieved_goal: jax.Array) -> jax.Array:
    """Euclidean distance [...] from the achieved goal over the kept dimensions [..., n]."""
    return jnp.linalg.norm(apply_mask(goal, mask, achieved_goal) - achieved_goal, axis=-1)


def is_achieved(
    goal: jax.Array, mask: jax.Array, achieved_goal: jax.Array, threshold: ArrayLike
) -> jax.Array:
    """Whether masked goals are achieved [...]; the threshold broadcasts against [...]."""
    return masked_distance(goal, mask, achieved_goal) < threshold
