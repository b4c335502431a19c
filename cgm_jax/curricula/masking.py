"""Curriculum goal masking: the mask sampler and what it learns from.

A mask keeps (1) or masks (0) each goal dimension. A masked dimension counts as achieved, so
masks make goals easier. Masks are drawn so that the estimated success rate of the masked goal
is near a chosen rate c_g. References are to Eppe, Magg and Wermter (2019).
"""

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from jax.scipy.special import xlogy
from jax.typing import ArrayLike


def goal_masks(goal_size: int) -> jax.Array:
    """All masks of a goal, in binary order with the first dimension as the highest bit.

    Args:
        goal_size: number of goal dimensions n, at least 1.

    Returns:
        [2^n, n] float32 of 0 and 1. Row 0 masks everything, the last row is the full goal.

    Raises:
        ValueError: `goal_size` is below 1.
    """
    if goal_size < 1:
        raise ValueError(f"goal_size: {goal_size} is not at least 1")
    indices = np.arange(2**goal_size)[:, None]
    return jnp.asarray((indices >> np.arange(goal_size)[::-1]) & 1, jnp.float32)


def mask_success_rates(masks: jax.Array, subgoal_rates: jax.Array) -> jax.Array:
    """Estimated success rate of every mask, if sub-goals were achieved independently.

    Section III: c_m is the product of the rates of the kept dimensions, so the all-zero mask
    has rate 1.

    Args:
        masks: [m, n] of 0 and 1.
        subgoal_rates: [n] in [0, 1].

    Returns:
        [m] in [0, 1].
    """
    return jnp.prod(jnp.where(masks > 0, subgoal_rates, 1.0), axis=-1)


def mask_probabilities(success_rates: jax.Array, c_g: ArrayLike, kappa: ArrayLike) -> jax.Array:
    """Probability of drawing each mask: p(m) proportional to (1 - |c_m - c_g|)^kappa.

    The paper prints |c_m - c_g|^kappa, which would prefer masks *far* from c_g; its text and
    the authors' program say near. Computed in log space, so that kappa = 1000 neither
    underflows nor divides by zero.

    Args:
        success_rates: c_m, [m] in [0, 1].
        c_g: the rate aimed at, scalar in [0, 1].
        kappa: sharpness, scalar at least 0; 0 draws masks uniformly.

    Returns:
        [m], summing to 1. Uniform in the one case where every mask has weight 0: all c_m at
        the opposite end of [0, 1] from c_g.
    """
    closeness = 1.0 - jnp.abs(success_rates - c_g)
    logits = xlogy(kappa, closeness)
    possible = jnp.isfinite(logits).any()
    return jax.nn.softmax(jnp.where(possible, logits, 0.0))


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


def sample_masks(key: jax.Array, probabilities: jax.Array, count: int) -> jax.Array:
    """Draw mask indices [count], int32, with the given probabilities [m]."""
    return jax.random.categorical(key, jnp.log(probabilities), shape=(count,))


class SuccessHistory(struct.PyTreeNode):
    """Outcomes of the last h evaluation rollouts, per sub-goal or per mask.

    Attributes:
        successes: [h, columns] of 0 and 1, the newest last.
        count: how many rows, counted from the last, are filled; int32 scalar.
    """

    successes: jax.Array
    count: jax.Array


def empty_history(length: int, columns: int) -> SuccessHistory:
    """A history of the last `length` rollouts that has seen none."""
    return SuccessHistory(jnp.zeros((length, columns)), jnp.zeros((), jnp.int32))


def record_successes(
    history: SuccessHistory, successes: jax.Array, valid: jax.Array
) -> SuccessHistory:
    """Append evaluation rollouts; the oldest beyond the history's length drop out.

    Args:
        history: outcomes so far, of length h.
        successes: [k, columns], in the order in which they happened.
        valid: [k] bool; rollouts with broken physics are left out.
    """
    length = history.successes.shape[0]
    filled = jnp.arange(length) >= length - history.count
    rows = jnp.concatenate([history.successes, successes.astype(history.successes.dtype)])
    counts = jnp.concatenate([filled, valid])
    newest_last = jnp.argsort(counts, stable=True)[-length:]
    return SuccessHistory(
        successes=rows[newest_last],
        count=jnp.minimum(history.count + valid.sum(dtype=jnp.int32), length),
    )


def success_rates(history: SuccessHistory, default: ArrayLike) -> jax.Array:
    """Success rate of every column over the history; `default` before any evaluation."""
    length = history.successes.shape[0]
    filled = jnp.arange(length) >= length - history.count
    total = jnp.sum(jnp.where(filled[:, None], history.successes, 0.0), axis=0)
    return jnp.where(history.count > 0, total / jnp.maximum(history.count, 1), default)


def subgoal_rates(history: SuccessHistory, c_g: ArrayLike) -> jax.Array:
    """Success rate [n] per sub-goal over the history.

    Before any evaluation it is c_g^(1/n), so that the full goal is estimated at c_g.
    """
    return success_rates(history, jnp.power(c_g, 1.0 / history.successes.shape[-1]))


def joint_success_rates(masks: jax.Array, history: SuccessHistory, c_g: ArrayLike) -> jax.Array:
    """Success rate [m] of every mask, without assuming that sub-goals are independent.

    Not in the paper, whose product this judges: the share of the history's rollouts that achieved
    all kept dimensions at once. Before any evaluation it is the paper's product.

    Args:
        masks: [m, n] of 0 and 1.
        history: outcomes of evaluation rollouts, of length h.
        c_g: the rate aimed at, scalar in [0, 1].
    """
    achieved = jnp.all((masks == 0) | (history.successes[:, None] > 0), axis=-1)  # [h, m]
    product = mask_success_rates(masks, subgoal_rates(history, c_g))
    return success_rates(SuccessHistory(achieved, history.count), product)
