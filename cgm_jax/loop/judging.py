"""What counts as success and what is rewarded: by distance, or by an environment's own rules.

An environment's rules are about an achieved and a desired goal. Under a mask they get the goal that
the networks see: in masked dimensions the desired goal is what is achieved (equation 1 of Eppe,
Magg and Wermter 2019), so that these count as achieved to any rule that compares dimension by
dimension. A sub-goal is the mask that keeps one dimension.
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

from cgm_jax.config.fields import SettingError
from cgm_jax.envs import GoalEnvironment
from cgm_jax.envs.goals import apply_mask, is_achieved
from cgm_jax.replay.protocol import Transitions

Rule = Callable[[jax.Array, jax.Array], jax.Array]
"""From an achieved and a desired goal, each [n], to a scalar."""

SPARSE = (-1.0, 0.0)


def has_own_rules(env: GoalEnvironment) -> bool:
    """Whether success is not a matter of distance below a threshold."""
    return _success_rule(env) is not None


def succeeds(
    env: GoalEnvironment,
    goal: jax.Array,
    mask: jax.Array,
    achieved_goal: jax.Array,
    threshold: jax.Array,
) -> jax.Array:
    """Whether masked goals are achieved [...].

    Args:
        env: the environment.
        goal: [..., n], before masking.
        mask: [..., n].
        achieved_goal: [..., n].
        threshold: [...], not read where the environment has a rule of its own.
    """
    rule = _success_rule(env)
    if rule is None:
        return is_achieved(goal, mask, achieved_goal, threshold)
    return _mapped(rule, achieved_goal, apply_mask(goal, mask, achieved_goal))


def subgoals_succeed(
    env: GoalEnvironment, goal: jax.Array, achieved_goal: jax.Array, distance_threshold: float
) -> jax.Array:
    """Whether each dimension of whole goals [..., n] is achieved, [..., n]."""
    rule = _success_rule(env)
    if rule is None:
        return jnp.abs(achieved_goal - goal) < distance_threshold
    single = jnp.eye(goal.shape[-1])
    masked = apply_mask(goal[..., None, :], single, achieved_goal[..., None, :])
    achieved = jnp.broadcast_to(achieved_goal[..., None, :], masked.shape)
    return _mapped(rule, achieved, masked)


def rewards(env: GoalEnvironment, drawn: Transitions) -> jax.Array:
    """Rewards [...] of transitions: the environment's own, or 0 for success and -1 otherwise.

    Raises:
        SettingError: the relabelling does not say what was achieved.
    """
    own_reward, rule = getattr(env, "goal_reward", None), _success_rule(env)
    if own_reward is None and rule is None:
        return drawn.reward
    if drawn.next_achieved is None:
        raise SettingError("relabelling: must fill next_achieved, since env has its own rules")
    if own_reward is not None:

        def reward(achieved: jax.Array, desired: jax.Array) -> jax.Array:
            return jnp.asarray(own_reward(achieved, desired), jnp.float32)

        own = _mapped(reward, drawn.next_achieved, drawn.next_goal)
        return jnp.clip(own, *reward_range(env))
    assert rule is not None
    own = jnp.where(_mapped(rule, drawn.next_achieved, drawn.next_goal), 0.0, -1.0)
    if drawn.subgoal is None:
        return own
    # A stage has no rule but its threshold.
    flags = drawn.subgoal[..., : len(env.stages)]  # pyright: ignore[reportAttributeAccessIssue]
    return jnp.where(flags.any(axis=-1), drawn.reward, own)


def reward_range(env: GoalEnvironment) -> tuple[float, float]:
    """Least and greatest reward.

    Raises:
        SettingError: the environment has rewards of its own, but does not say what they lie within.
    """
    if not hasattr(env, "goal_reward"):
        return SPARSE
    own = getattr(env, "reward_range", None)
    if own is None:
        raise SettingError("env: it has goal_reward, so it needs reward_range, (least, greatest)")
    least, greatest = own
    return float(least), float(greatest)


def may_end(env: GoalEnvironment) -> bool:
    """Whether the environment ends episodes before their last step."""
    return hasattr(env, "is_terminal")


def ends(env: GoalEnvironment, states: Any) -> jax.Array:
    """Whether an environment that may end episodes ends them in states [E, ...], [E] bool."""
    rule = env.is_terminal  # pyright: ignore[reportAttributeAccessIssue]
    return jnp.asarray(jax.vmap(rule)(states), bool)


def _success_rule(env: GoalEnvironment) -> Rule | None:
    """The environment's own, of which there is one at most: a function, or a tolerance."""
    rule, tolerance = getattr(env, "goal_success", None), getattr(env, "goal_tolerance", None)
    if rule is not None:
        return lambda achieved, desired: jnp.asarray(rule(achieved, desired), bool)
    if tolerance is None:
        return None
    unit = jnp.asarray(tolerance, jnp.float32)
    return lambda achieved, desired: jnp.linalg.norm((achieved - desired) / unit) < 1.0


def _mapped(rule: Rule, achieved_goal: jax.Array, goal: jax.Array) -> jax.Array:
    """A rule for one pair of goals [n], for pairs [..., n]."""
    for _ in range(goal.ndim - 1):
        rule = jax.vmap(rule)
    return rule(achieved_goal, goal)
