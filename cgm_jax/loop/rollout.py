"""Episodes of many environments at once, in one scan."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from flax import struct
from jaxtyping import Array, Bool

from cgm_jax.curricula.protocol import Goals, Outcomes
from cgm_jax.envs import GoalEnvironment
from cgm_jax.envs.goals import apply_mask
from cgm_jax.loop.exploration import Exploration
from cgm_jax.loop.judging import may_end, subgoals_succeed, succeeds
from cgm_jax.replay.ring import Episodes

State = Any
"""Brax's, or what an environment has in its place, with `obs` and `metrics` alike."""

Policy = Callable[[jax.Array, jax.Array, Exploration | None], jax.Array]
"""From observations [E, o], masked goals [E, n] and this step's noise to actions [E, a]."""


class Rollout(struct.PyTreeNode):
    """Episodes and what became of them.

    Attributes:
        episodes: E episodes.
        outcomes: which of them count, and what they achieved.
        record: what `roll_out` was asked to keep of every state, leading axis [T + 1].
    """

    episodes: Episodes
    outcomes: Outcomes
    record: Any = None


def reset(env: GoalEnvironment, key: jax.Array, count: int) -> State:
    """States of `count` environments, each from a reset of its own."""
    return jax.vmap(env.reset)(jax.random.split(key, count))


def drawn_goals(env: GoalEnvironment, first: State) -> Goals:
    """The goals that the environments drew, whole, at the environment's own threshold."""
    desired = first.obs["desired_goal"]
    return Goals(
        desired=desired,
        mask=jnp.ones_like(desired),
        threshold=jnp.full(desired.shape[0], env.distance_threshold, desired.dtype),
    )


def roll_out(
    env: GoalEnvironment,
    policy: Policy,
    first: State,
    goals: Goals,
    exploration: Exploration | None = None,
    *,
    keep: Callable[[State], Any] = lambda _: None,
    visit_key: jax.Array | None = None,
) -> Rollout:
    """Run one whole episode in each of E environments.

    Where the environment ends an episode early, its state stays as it is until the last step.

    Args:
        env: the environment.
        policy: called once per step for all environments.
        first: states in which the episodes begin, leading axis [E].
        goals: what they are to achieve; `goals.start` is not read.
        exploration: noise for every step, leading axes [T, E]; None for a policy without.
        keep: from the state of all environments to what becomes of it in `Rollout.record`.
        visit_key: draws the step of each episode whose state is kept in `Outcomes.visited`; None
            to keep none.
    """
    count = goals.mask.shape[0]
    ends = jax.vmap(env.is_terminal) if may_end(env) else None  # pyright: ignore
    visits = None
    if visit_key is not None:
        visits = jax.random.randint(visit_key, (count,), 0, env.episode_length)

    def step(carry: tuple[State, Any], now: tuple[Any, jax.Array]) -> tuple[Any, tuple[Any, ...]]:
        (state, visited), (noise, index) = carry, now
        observation, achieved = state.obs["observation"], state.obs["achieved_goal"]
        action = policy(observation, apply_mask(goals.desired, goals.mask, achieved), noise)
        next_state = jax.vmap(env.step)(state, action)
        ended = None if ends is None else ends(state)
        if ended is not None:
            next_state = choose(ended, state, next_state)
        warnings = next_state.metrics.get("physics_warnings", jnp.zeros(count))
        if visits is not None:
            visited = choose(visits == index, next_state, visited)
        return (next_state, visited), (observation, achieved, action, warnings, ended, keep(state))

    steps = (exploration, jnp.arange(env.episode_length))
    begin = (first, None if visits is None else first)
    (last, visited), rows = jax.lax.scan(step, begin, steps)
    observation, achieved, action, warnings, ended, kept = rows
    observation = jnp.concatenate([observation, last.obs["observation"][None]])
    achieved = jnp.concatenate([achieved, last.obs["achieved_goal"][None]])
    episodes = Episodes(
        observation=observation.swapaxes(0, 1),
        achieved_goal=achieved.swapaxes(0, 1),
        action=action.swapaxes(0, 1),
        desired_goal=goals.desired,
        mask=goals.mask,
        threshold=goals.threshold,
        length=None if ends is None else _length(ended, ends(last)),
    )
    rollout = _judge(env, episodes, goals, warnings.sum(axis=0))
    record = jax.tree.map(lambda rows, row: jnp.concatenate([rows, row[None]]), kept, keep(last))
    return rollout.replace(record=record, outcomes=rollout.outcomes.replace(visited=visited))


def choose(condition: Bool[Array, " E"], yes: State, no: State) -> State:
    """Of two batches of states with leading axis [E], row by row by a condition [E]."""
    pick = jax.vmap(lambda chosen, x, y: jnp.where(chosen, x, y))
    return jax.tree.map(lambda x, y: pick(condition, x, y), yes, no)


def _length(ended: jax.Array, ended_at_last: jax.Array) -> jax.Array:
    """Steps before the environment ended each episode [E], T + 1 where it did not.

    Args:
        ended: before each step, [T, E].
        ended_at_last: after the last one, [E].
    """
    steps = jnp.sum(~ended, axis=0, dtype=jnp.int32)
    return jnp.where(ended_at_last, steps, ended.shape[0] + 1)


def _judge(env: GoalEnvironment, episodes: Episodes, goals: Goals, warnings: jax.Array) -> Rollout:
    goal, final = episodes.desired_goal, episodes.achieved_goal[:, -1]
    finite = [
        jnp.isfinite(rows).all(axis=(1, 2))
        for rows in (episodes.observation, episodes.achieved_goal, episodes.action)
    ]
    kept = jnp.isfinite(goal) | (goals.mask == 0)
    valid = (warnings == 0) & jnp.stack(finite).all(axis=0) & kept.all(axis=1)
    if episodes.length is not None:  # one that ended before its first step teaches nothing
        valid &= episodes.length > 0
    outcomes = Outcomes(
        goals=goals,
        success=succeeds(env, goal, goals.mask, final, goals.threshold),
        subgoal_success=subgoals_succeed(env, goal, final, env.distance_threshold),
        valid=valid,
        observation=episodes.observation[:, 0],
    )
    return Rollout(episodes=episodes, outcomes=outcomes)
