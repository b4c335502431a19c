"""Hindsight experience replay: transitions whose goal was reached later in their episode.

Andrychowicz et al. (2017), strategy "future": a relabelled transition at step t gets the goal
achieved at a uniformly drawn later step t' of {t+1..T}, with the full mask. The others keep
their episode's own goal and mask. Where the environment ended an episode, T is its last step, and
what ended it ends it whatever the goal, as in Stable-Baselines3's HER.

With the filter on, only episodes that moved the achieved goal are relabelled. In the others every
hindsight goal is achieved from the start by doing nothing, and early on, while an arm has yet to
find its block, they are nearly all there is. With masks on, hindsight goals keep their episode's
mask, as GS-HER does (2026, arXiv 2606.09476).
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from cgm_jax.config.fields import settings, traced
from cgm_jax.envs.goals import apply_mask, is_achieved
from cgm_jax.replay.protocol import Relabelling, Transitions
from cgm_jax.replay.ring import Replay, size, steps_taken

if TYPE_CHECKING:  # importing environments takes long, and starts JAX
    from cgm_jax.envs import Stage

MIN_MOTION = 0.05
"""An episode moved its achieved goal if it strayed farther than this share of the distance
threshold from where it began."""


class Drawn(NamedTuple):
    """Places in the ring, [count] each.

    Attributes:
        episode, step: of the transition.
        future: a later step of its episode, whose achieved goal is the hindsight goal.
        relabelled: whether the transition gets that goal, bool.
    """

    episode: jax.Array
    step: jax.Array
    future: jax.Array
    relabelled: jax.Array


@settings
class Future(Relabelling):
    """HER's strategy "future". Its settings, with the names of the options."""

    her: bool = traced(True, "hindsight experience replay; off: only original goals")
    her_k: float = traced(6.0, "relabelled transitions for each original one", 0, 1e6)
    her_filter: bool = traced(False, "relabel only episodes that moved the achieved goal")
    her_masks: bool = traced(False, "hindsight goals keep their episode's mask")

    def sample(
        self,
        key: jax.Array,
        replay: Replay,
        count: int,
        distance_threshold: float,
        stages: "Sequence[Stage]" = (),
    ) -> Transitions:
        """Draw transitions uniformly from the ring, and relabel each with probability k / (k + 1).

        With the filter, those to relabel come uniformly from the episodes that moved the achieved
        goal, while there is one.
        """
        del stages
        uniform = jax.random.uniform(key, (4, count))
        return self.transitions(replay, self.draw(replay, uniform, distance_threshold))

    def draw(
        self,
        replay: Replay,
        uniform: Float[Array, "4 count"],
        distance_threshold: float,
        anywhere: Bool[Array, " count"] | bool = False,
    ) -> Drawn:
        """Turn numbers uniform in [0, 1) into places; the filter is not for rows `anywhere`."""
        episodes = replay.episodes
        episode_length = episodes.action.shape[1]
        for_episode, for_step, for_future, for_relabel = uniform
        relabel = for_relabel < jnp.where(self.her, self.her_k / (self.her_k + 1.0), 0.0)
        moved = moved_goal(episodes.achieved_goal, distance_threshold)
        eligible = moved & (jnp.arange(len(moved)) < size(replay)) & self.her_filter
        taken = steps_taken(episodes)
        episode = jnp.where(
            relabel & eligible.any() & jnp.logical_not(anywhere),
            _drawn_among(eligible if taken is None else jnp.where(eligible, taken, 0), for_episode),
            integer_below(jnp.maximum(size(replay), 1), for_episode)
            if taken is None
            else _drawn_among(taken, for_episode),
        )
        steps = episode_length if taken is None else taken[episode]
        step = integer_below(steps, for_step)
        future = step + 1 + integer_below(steps - step, for_future)
        return Drawn(episode, step, future, relabel)

    def transitions(self, replay: Replay, drawn: Drawn) -> Transitions:
        """The transitions at these places, with hindsight goals where they are relabelled."""
        episodes = replay.episodes
        episode, step, future, relabel = drawn
        ends = None if episodes.length is None else episodes.length[episode]
        hindsight_goal = episodes.achieved_goal[episode, future]
        goal = jnp.where(relabel[:, None], hindsight_goal, episodes.desired_goal[episode])
        whole = (relabel & ~jnp.asarray(self.her_masks))[:, None]
        mask = jnp.where(whole, 1.0, episodes.mask[episode])
        threshold = episodes.threshold[episode]
        achieved, next_achieved = (episodes.achieved_goal[episode, step + i] for i in (0, 1))
        return Transitions(
            observation=episodes.observation[episode, step],
            goal=apply_mask(goal, mask, achieved),
            mask=mask,
            threshold=threshold,
            action=episodes.action[episode, step],
            reward=jnp.where(is_achieved(goal, mask, next_achieved, threshold), 0.0, -1.0),
            next_observation=episodes.observation[episode, step + 1],
            next_goal=apply_mask(goal, mask, next_achieved),
            next_achieved=next_achieved,
            continues=None if ends is None else (step + 1 != ends).astype(jnp.float32),
        )

    def idle(self) -> frozenset[str]:
        """Without HER, what is about HER."""
        return frozenset() if self.her else frozenset({"her_k", "her_filter", "her_masks"})


def moved_goal(
    achieved_goal: Float[Array, "E steps n"], distance_threshold: float
) -> Bool[Array, " E"]:
    """Whether episodes moved their achieved goal [E, T + 1, n], [E] bool; see `MIN_MOTION`."""
    strayed = jnp.linalg.norm(achieved_goal[:, 1:] - achieved_goal[:, :1], axis=-1).max(axis=1)
    return strayed > MIN_MOTION * distance_threshold


def _drawn_among(
    weight: Bool[Array, " C"] | Int[Array, " C"], uniform: Float[Array, " count"]
) -> Int[Array, " count"]:
    """Turn numbers uniform in [0, 1) into indices, each as likely as its weight, a whole number."""
    count = jnp.cumsum(weight)
    return jnp.searchsorted(count, 1 + integer_below(jnp.maximum(count[-1], 1), uniform))


def integer_below(bound: int | jax.Array, uniform: Float[Array, "*shape"]) -> Int[Array, "*shape"]:
    """Turn numbers uniform in [0, 1) into integers uniform in {0..bound - 1}.

    Far cheaper to compile than `jax.random.randint`. JAX's float32 draws have 23 bits, which makes
    probabilities uneven by at most bound / 2^23. Rounding must not reach the bound.
    """
    scaled = uniform * jnp.asarray(bound, uniform.dtype)
    return jnp.minimum(jnp.floor(scaled).astype(jnp.int32), bound - 1)
