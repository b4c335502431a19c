"""Episodes of many environments at once, in one scan."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from brax.envs.base import State
from flax import struct

from cgm_jax.curricula.masking import apply_mask, masked_distance
from cgm_jax.envs import GoalEnvironment
from cgm_jax.loop.exploration import Exploration
from cgm_jax.replay.ring import Episodes

Policy = Callable[[jax.Array, jax.Array, Exploration | None], jax.Array]
"""From observations [E, o], masked goals [E, n] and this step's noise to actions [E, a]."""


class Rollout(struct.PyTreeNode):
    """Episodes and what became of them.

    Attributes:
        episodes: E episodes.
        masked_success: whether the masked goal is achieved at the last step, [E] bool.
        subgoal_success: whether each dimension of the whole goal is, [E, n] bool.
        success: whether the whole goal is, [E] bool.
        valid: whether the physics held; episodes that are not valid must be dropped, [E] bool.
        record: what `roll_out` was asked to keep of every state, leading axis [T + 1].
    """

    episodes: Episodes
    masked_success: jax.Array
    subgoal_success: jax.Array
    success: jax.Array
    valid: jax.Array
    record: Any = None


def roll_out(
    env: GoalEnvironment,
    policy: Policy,
    key: jax.Array,
    masks: jax.Array,
    exploration: Exploration | None = None,
    keep: Callable[[State], Any] = lambda _: None,
) -> Rollout:
    """Run one whole episode in each of E environments, from a fresh reset.

    Args:
        env: the environment.
        policy: called once per step for all environments.
        key: for the resets, one for all or one for each, [E]; consumed.
        masks: one goal mask per environment, [E, n].
        exploration: noise for every step, leading axes [T, E]; None for a policy without.
        keep: from the state of all environments to what becomes of it in `Rollout.record`.
    """
    keys = key if key.ndim else jax.random.split(key, masks.shape[0])
    first = jax.vmap(env.reset)(keys)
    goal = first.obs["desired_goal"]

    def step(state: State, noise: Exploration | None) -> tuple[State, tuple[Any, ...]]:
        observation, achieved = state.obs["observation"], state.obs["achieved_goal"]
        action = policy(observation, apply_mask(goal, masks, achieved), noise)
        next_state = jax.vmap(env.step)(state, action)
        warnings = next_state.metrics.get("physics_warnings", jnp.zeros(masks.shape[0]))
        return next_state, (observation, achieved, action, warnings, keep(state))

    last, (observation, achieved, action, warnings, kept) = jax.lax.scan(
        step, first, exploration, length=env.episode_length
    )
    observation = jnp.concatenate([observation, last.obs["observation"][None]])
    achieved = jnp.concatenate([achieved, last.obs["achieved_goal"][None]])
    episodes = Episodes(
        observation=observation.swapaxes(0, 1),
        achieved_goal=achieved.swapaxes(0, 1),
        action=action.swapaxes(0, 1),
        desired_goal=goal,
        mask=masks,
    )
    rollout = _judge(episodes, warnings.sum(axis=0), env.distance_threshold)
    record = jax.tree.map(lambda rows, row: jnp.concatenate([rows, row[None]]), kept, keep(last))
    return rollout.replace(record=record)


def _judge(episodes: Episodes, warnings: jax.Array, threshold: float) -> Rollout:
    goal, final = episodes.desired_goal, episodes.achieved_goal[:, -1]
    finite = [
        jnp.isfinite(rows).all(axis=(1, 2))
        for rows in (episodes.observation, episodes.achieved_goal, episodes.action)
    ]
    return Rollout(
        episodes=episodes,
        masked_success=masked_distance(goal, episodes.mask, final) < threshold,
        subgoal_success=jnp.abs(final - goal) < threshold,
        success=jnp.linalg.norm(final - goal, axis=-1) < threshold,
        valid=(warnings == 0) & jnp.stack(finite).all(axis=0),
    )
