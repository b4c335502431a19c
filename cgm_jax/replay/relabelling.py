"""Hindsight experience replay: transitions whose goal was reached later in their episode.

Andrychowicz et al. (2017), strategy "future": a relabelled transition at step t gets the goal
achieved at a uniformly drawn later step t' of {t+1..T}, with the full mask. The others keep
their episode's own goal and mask.

With the filter on, only episodes that moved the achieved goal are relabelled. In the others every
hindsight goal is achieved from the start by doing nothing, and early on, while an arm has yet to
find its block, they are nearly all there is.
"""

import jax
import jax.numpy as jnp
from flax import struct

from cgm_jax.curricula.masking import apply_mask, masked_distance
from cgm_jax.replay.ring import Replay, size

LEAST_MOTION = 0.05
"""An episode moved its achieved goal if it strayed farther than this share of the distance
threshold from where it began."""


class Transitions(struct.PyTreeNode):
    """Transitions as the networks see them: goals are masked, rewards recomputed.

    Attributes:
        observation, next_observation: [..., observation_size].
        goal, next_goal: masked with the achieved goal of their own step, [..., n].
        action: [..., action_size].
        reward: 0 where the next state achieves the masked goal, else -1; [...].
    """

    observation: jax.Array
    goal: jax.Array
    action: jax.Array
    reward: jax.Array
    next_observation: jax.Array
    next_goal: jax.Array


def sample_transitions(
    key: jax.Array,
    replay: Replay,
    count: int,
    *,
    her_probability: jax.Array,
    her_filter: jax.Array,
    distance_threshold: float,
) -> Transitions:
    """Draw transitions uniformly from the ring, and relabel each with probability k / (k + 1).

    With the filter, those to relabel come uniformly from the episodes that moved the achieved
    goal, while there is one.

    Args:
        key: consumed.
        replay: holds at least one episode.
        count: how many.
        her_probability: chance of relabelling, scalar; 0 is DDPG without HER.
        her_filter: whether to relabel only episodes that moved the achieved goal, bool scalar.
        distance_threshold: a goal is achieved closer than this.

    Returns:
        `count` transitions.
    """
    episodes = replay.episodes
    episode_length = episodes.action.shape[1]
    uniform = jax.random.uniform(key, (4, count))
    relabel = uniform[3] < her_probability
    moved = moved_goal(episodes.achieved_goal, distance_threshold)
    eligible = moved & (jnp.arange(len(moved)) < size(replay)) & her_filter
    episode = jnp.where(
        relabel & eligible.any(),
        _drawn_among(eligible, uniform[0]),
        _integer_below(jnp.maximum(size(replay), 1), uniform[0]),
    )
    step = _integer_below(episode_length, uniform[1])
    future = step + 1 + _integer_below(episode_length - step, uniform[2])

    hindsight_goal = episodes.achieved_goal[episode, future]
    goal = jnp.where(relabel[:, None], hindsight_goal, episodes.desired_goal[episode])
    mask = jnp.where(relabel[:, None], 1.0, episodes.mask[episode])
    achieved, next_achieved = (episodes.achieved_goal[episode, step + i] for i in (0, 1))
    distance = masked_distance(goal, mask, next_achieved)
    return Transitions(
        observation=episodes.observation[episode, step],
        goal=apply_mask(goal, mask, achieved),
        action=episodes.action[episode, step],
        reward=jnp.where(distance < distance_threshold, 0.0, -1.0),
        next_observation=episodes.observation[episode, step + 1],
        next_goal=apply_mask(goal, mask, next_achieved),
    )


def moved_goal(achieved_goal: jax.Array, distance_threshold: float) -> jax.Array:
    """Whether episodes moved their achieved goal [E, T + 1, n], [E] bool; see `LEAST_MOTION`."""
    strayed = jnp.linalg.norm(achieved_goal[:, 1:] - achieved_goal[:, :1], axis=-1).max(axis=1)
    return strayed > LEAST_MOTION * distance_threshold


def _drawn_among(eligible: jax.Array, uniform: jax.Array) -> jax.Array:
    """Turn numbers uniform in [0, 1) into indices, uniform among those that are eligible."""
    count = jnp.cumsum(eligible)
    return jnp.searchsorted(count, 1 + _integer_below(count[-1], uniform))


def _integer_below(bound: int | jax.Array, uniform: jax.Array) -> jax.Array:
    """Turn numbers uniform in [0, 1) into integers uniform in {0..bound - 1}.

    Far cheaper to compile than `jax.random.randint`. JAX's float32 draws have 23 bits, which makes
    probabilities uneven by at most bound / 2^23. Rounding must not reach the bound.
    """
    return jnp.minimum(jnp.floor(uniform * bound).astype(jnp.int32), bound - 1)
