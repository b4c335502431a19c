"""Episodes of many environments at once: in one scan, or step by step where they are cut."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from flax import struct

from cgm_jax.curricula.parts.rows import where_rows
from cgm_jax.curricula.protocol import Goals, Outcomes
from cgm_jax.envs import GoalEnvironment
from cgm_jax.envs.goals import apply_mask
from cgm_jax.loop.exploration import Exploration
from cgm_jax.loop.judging import ends, may_end, subgoals_succeed, succeeds
from cgm_jax.replay.ring import Episodes

State = Any
"""Brax's, or what an environment has in its place, with `obs` and `metrics` alike."""

Policy = Callable[[jax.Array, jax.Array, Exploration | None], jax.Array]
"""From observations [E, o], masked goals [E, n] and this step's noise to actions [E, a]."""


_Carry = tuple[State, Any, Any]
"""What a step hands on: states, and `visited` and `visits` as in `PartialRollout`."""


class Rollout(struct.PyTreeNode):
    """Episodes and what became of them.

    Attributes:
        episodes: E episodes.
        outcomes: which of them count, and what they achieved.
        broken: whose physics broke or whose numbers are not finite, [E] bool. Those that ended
            before their first step do not count either, but are not broken.
        drawn_goal: what the environments drew, [E, n], where curricula may have chosen others.
        record: what `roll_out` was asked to keep of every state, leading axis [T + 1].
    """

    episodes: Episodes
    outcomes: Outcomes
    broken: jax.Array
    drawn_goal: jax.Array
    record: Any = None


class PartialRollout(struct.PyTreeNode):
    """Episodes that are not over yet, of E environments.

    Attributes:
        state: of the environments after the last step.
        visited: what becomes of `Outcomes.visited`, or None.
        visits: when that is taken, or None: the step, [E] int32, or, where episodes may end early,
            whether each step replaces what was taken before, [T, E] bool.
        goals: what the episodes are to achieve.
        exploration: noise for every step, leading axes [T, E], or None.
        rows: what each step has left, leading axes [T, E]; zeros for steps to come.
    """

    state: State
    visited: Any
    visits: jax.Array | None
    goals: Goals
    exploration: Exploration | None
    rows: Any


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
        visit_key: draws the step of each episode after which its state is kept in
            `Outcomes.visited`, of those that do not end it; None to keep none.
    """
    carry = _start(env, first, goals, visit_key)
    steps = (exploration, jnp.arange(env.episode_length))
    carry, rows = jax.lax.scan(_step_of(env, policy, goals, keep), carry, steps)
    return _finished(env, goals, carry, rows, keep)


def begin_rollout(
    env: GoalEnvironment,
    policy: Policy,
    first: State,
    goals: Goals,
    exploration: Exploration | None = None,
    *,
    visit_key: jax.Array | None = None,
) -> PartialRollout:
    """Episodes before their first step; `step_rollout` and `finish_rollout` do the rest.

    Args:
        env: the environment.
        policy: of which only the shape of actions is needed here.
        first: states in which the episodes begin, leading axis [E].
        goals: what they are to achieve; `goals.start` is not read.
        exploration: noise for every step, leading axes [T, E].
        visit_key: as for `roll_out`.
    """
    carry = _start(env, first, goals, visit_key)
    step, now = _step_of(env, policy, goals, _nothing), _at(exploration, jnp.asarray(0))
    _, row = jax.eval_shape(step, carry, (now, jnp.asarray(0)))
    rows = jax.tree.map(lambda x: jnp.zeros((env.episode_length, *x.shape), x.dtype), row)
    return PartialRollout(*carry, goals=goals, exploration=exploration, rows=rows)


def step_rollout(
    env: GoalEnvironment, policy: Policy, partial: PartialRollout, index: int | jax.Array
) -> PartialRollout:
    """Take step `index` of episodes whose steps before it are done."""
    step = _step_of(env, policy, partial.goals, _nothing)
    now = (_at(partial.exploration, index), jnp.asarray(index))
    carry, row = step((partial.state, partial.visited, partial.visits), now)
    state, visited, visits = carry
    rows = jax.tree.map(lambda rows, x: rows.at[index].set(x), partial.rows, row)
    return partial.replace(state=state, visited=visited, visits=visits, rows=rows)


def finish_rollout(env: GoalEnvironment, partial: PartialRollout) -> Rollout:
    """What became of episodes whose steps are all done."""
    carry = (partial.state, partial.visited, partial.visits)
    return _finished(env, partial.goals, carry, partial.rows, _nothing)


def _nothing(_: State) -> None:
    """What is kept of states whose record nobody wants."""


def _at(exploration: Exploration | None, index: int | jax.Array) -> Exploration | None:
    return jax.tree.map(lambda noise: noise[index], exploration)


def _start(env: GoalEnvironment, first: State, goals: Goals, visit_key: jax.Array | None) -> _Carry:
    if visit_key is None:
        return first, None, None
    steps, count = env.episode_length, goals.mask.shape[0]
    if not may_end(env):
        return first, first, jax.random.randint(visit_key, (count,), 0, steps)
    # How many steps there will be is not known: of i states each is kept if the i-th replaces the
    # one before by a chance of 1 / i (reservoir sampling).
    number = jnp.arange(1.0, steps + 1.0, dtype=jnp.float32)[:, None]
    return first, first, jax.random.uniform(visit_key, (steps, count)) * number < 1.0


def _step_of(
    env: GoalEnvironment, policy: Policy, goals: Goals, keep: Callable[[State], Any]
) -> Callable[[_Carry, tuple[Exploration | None, jax.Array]], tuple[_Carry, tuple[Any, ...]]]:
    """A step of all environments: from what is carried, and the noise and number of the step."""
    count = goals.mask.shape[0]
    ending = may_end(env)

    def step(carry: _Carry, now: tuple[Any, jax.Array]) -> tuple[_Carry, tuple[Any, ...]]:
        (state, visited, visits), (noise, index) = carry, now
        observation, achieved = state.obs["observation"], state.obs["achieved_goal"]
        action = policy(observation, apply_mask(goals.desired, goals.mask, achieved), noise)
        next_state = jax.vmap(env.step)(state, action)
        ended = ends(env, state) if ending else None
        if ended is not None:
            next_state = where_rows(ended, state, next_state)
        warnings = _warnings(state, count)
        if visits is not None:
            now_visited = visits[index] & ~ends(env, next_state) if ending else visits == index
            visited = where_rows(now_visited, next_state, visited)
        left = (observation, achieved, action, warnings, ended, keep(state))
        return (next_state, visited, visits), left

    return step


def _finished(
    env: GoalEnvironment, goals: Goals, carry: _Carry, rows: Any, keep: Callable[[State], Any]
) -> Rollout:
    """Episodes from what each step has left, [T, E, ...], and the states after the last one."""
    last, visited, _ = carry
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
        length=None if ended is None else _length(ended, ends(env, last)),
    )
    broken = warnings.sum(axis=0) + _warnings(last, goals.mask.shape[0])
    rollout = _judge(env, episodes, goals, broken, last.obs["desired_goal"])
    record = jax.tree.map(lambda rows, row: jnp.concatenate([rows, row[None]]), kept, keep(last))
    return rollout.replace(record=record, outcomes=rollout.outcomes.replace(visited=visited))


def _warnings(state: State, count: int) -> jax.Array:
    """Whose physics broke on the way to this state: above 0, [E]."""
    return state.metrics.get("physics_warnings", jnp.zeros(count))


def _length(ended: jax.Array, ended_at_last: jax.Array) -> jax.Array:
    """Steps before the environment ended each episode [E], T + 1 where it did not.

    Args:
        ended: before each step, [T, E].
        ended_at_last: after the last one, [E].
    """
    steps = jnp.sum(~ended, axis=0, dtype=jnp.int32)
    return jnp.where(ended_at_last, steps, ended.shape[0] + 1)


def _judge(
    env: GoalEnvironment,
    episodes: Episodes,
    goals: Goals,
    warnings: jax.Array,
    drawn_goal: jax.Array,
) -> Rollout:
    goal, final = episodes.desired_goal, episodes.achieved_goal[:, -1]
    finite = [
        jnp.isfinite(rows).all(axis=(1, 2))
        for rows in (episodes.observation, episodes.achieved_goal, episodes.action)
    ]
    kept = jnp.isfinite(goal) | (goals.mask == 0)
    held = (warnings == 0) & jnp.stack(finite).all(axis=0) & kept.all(axis=1)
    valid = held
    if episodes.length is not None:  # one that ended before its first step teaches nothing
        valid = held & (episodes.length > 0)
    outcomes = Outcomes(
        goals=goals,
        success=succeeds(env, goal, goals.mask, final, goals.threshold),
        subgoal_success=subgoals_succeed(env, goal, final, env.distance_threshold),
        valid=valid,
        observation=episodes.observation[:, 0],
    )
    return Rollout(episodes=episodes, outcomes=outcomes, broken=~held, drawn_goal=drawn_goal)
