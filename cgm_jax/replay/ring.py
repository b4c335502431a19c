"""A ring buffer of whole episodes.

Whole, because HER needs an episode's later achieved goals, and because masked goals at every
step follow from one (goal, mask) pair and the achieved goals.
"""

import jax
import jax.numpy as jnp
from flax import struct
from jaxtyping import Array, Bool, Int


class Episodes(struct.PyTreeNode):
    """Episodes of T steps; the leading axis is the episode.

    Attributes:
        observation: [episodes, T + 1, observation_size].
        achieved_goal: [episodes, T + 1, n].
        action: [episodes, T, action_size].
        desired_goal: the goal before masking, [episodes, n].
        mask: [episodes, n] of 0 and 1.
        threshold: the goal is achieved closer than this, [episodes].
        length: the steps until the environment ended the episode, or T + 1 where it did not,
            int32 [episodes]; None where the environment never ends one.
    """

    observation: jax.Array
    achieved_goal: jax.Array
    action: jax.Array
    desired_goal: jax.Array
    mask: jax.Array
    threshold: jax.Array
    length: jax.Array | None = None


class Replay(struct.PyTreeNode):
    """The ring.

    Attributes:
        episodes: storage; leading axis is the capacity C.
        inserted: number of episodes ever inserted, int32 scalar. Episode i lies in slot i mod C.
    """

    episodes: Episodes
    inserted: jax.Array


def init_replay(
    capacity: int,
    episode_length: int,
    observation_size: int,
    goal_size: int,
    action_size: int,
    *,
    may_end: bool = False,
) -> Replay:
    """A ring for `capacity` episodes, which `may_end` before their last step.

    Raises:
        ValueError: the capacity is below 1.
    """
    if capacity < 1:
        raise ValueError(f"replay capacity: {capacity} episodes is not at least 1")
    episodes = Episodes(
        observation=jnp.zeros((capacity, episode_length + 1, observation_size)),
        achieved_goal=jnp.zeros((capacity, episode_length + 1, goal_size)),
        action=jnp.zeros((capacity, episode_length, action_size)),
        desired_goal=jnp.zeros((capacity, goal_size)),
        mask=jnp.zeros((capacity, goal_size)),
        threshold=jnp.zeros(capacity),
        length=jnp.zeros(capacity, jnp.int32) if may_end else None,
    )
    return Replay(episodes, jnp.zeros((), jnp.int32))


def insert(replay: Replay, episodes: Episodes, valid: Bool[Array, " batch"]) -> Replay:
    """Insert the valid ones of a batch of episodes, in order, over the oldest.

    Args:
        replay: the ring, of capacity C.
        episodes: a batch of at most C episodes.
        valid: [batch] bool.

    Raises:
        ValueError: the batch is larger than the ring.
    """
    capacity = replay.episodes.mask.shape[0]
    if valid.shape[0] > capacity:
        raise ValueError(f"{valid.shape[0]} episodes do not fit into a ring of {capacity}")
    place = replay.inserted + jnp.cumsum(valid) - 1
    slots = jnp.where(valid, place % capacity, capacity)  # outside the ring: dropped
    return Replay(
        episodes=jax.tree.map(
            lambda ring, batch: ring.at[slots].set(batch, mode="drop"), replay.episodes, episodes
        ),
        inserted=replay.inserted + valid.sum(dtype=jnp.int32),
    )


def steps_taken(episodes: Episodes) -> Int[Array, " episodes"] | None:
    """Steps until each episode was over, at most T, int32 [episodes]; None where all took T.

    States at a greater index are copies of the last one.
    """
    if episodes.length is None:
        return None
    return jnp.minimum(episodes.length, episodes.action.shape[1])


def size(replay: Replay) -> Int[Array, ""]:
    """Number of episodes that the ring holds, int32 scalar."""
    return jnp.minimum(replay.inserted, replay.episodes.mask.shape[0])
