"""All masks of a goal, how often each is expected to succeed, and the weights of the paper.

A mask keeps (1) or masks (0) each goal dimension. A masked dimension counts as achieved, so
masks make goals easier. References are to Eppe, Magg and Wermter (2019).
"""

import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.special import xlogy
from jax.typing import ArrayLike
from jaxtyping import Array, Float, Int

from cgm_jax.config.fields import SettingError
from cgm_jax.curricula.protocol import Goals, with_mask

MAX_TABULATED = 10
"""Dimensions of a goal up to which all 2^n masks are tabulated."""


def goal_masks(goal_size: int) -> Float[Array, "masks n"]:
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


def check_tabulated(setting: str, what: str, goal_size: int) -> None:
    """Check that all masks of a goal fit into a table.

    Args:
        setting: that needs the table.
        what: the value, or the estimate, for which it does.
        goal_size: number of goal dimensions n.

    Raises:
        SettingError: they do not.
    """
    if goal_size > MAX_TABULATED:
        raise SettingError(
            f"{setting}: {what} needs a table of all masks, so goals of at most {MAX_TABULATED} "
            f"dimensions, not {goal_size}"
        )


def mask_success_rates(
    masks: Float[Array, "masks n"], subgoal_rates: Float[Array, " n"]
) -> Float[Array, " masks"]:
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


def mask_probabilities(
    success_rates: Float[Array, " masks"], c_g: ArrayLike, kappa: ArrayLike
) -> Float[Array, " masks"]:
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


def proportional(weights: Float[Array, " m"]) -> Float[Array, " m"]:
    """Probabilities in proportion to weights [m] of at least 0; uniform where all are 0."""
    total = weights.sum()
    some = total > 0.0
    return jnp.where(some, weights / jnp.where(some, total, 1.0), 1.0 / len(weights))


def sample_masks(
    key: jax.Array, probabilities: Float[Array, " masks"], count: int
) -> Int[Array, " count"]:
    """Draw mask indices [count], int32, with the given probabilities [m]."""
    return jax.random.categorical(key, jnp.log(probabilities), shape=(count,))


def draw_from_table(drawn: Goals, key: jax.Array, probabilities: Float[Array, " masks"]) -> Goals:
    """The environment's goals, under masks drawn with the given probabilities [2^n]."""
    count, goal_size = drawn.mask.shape
    return with_mask(drawn, goal_masks(goal_size)[sample_masks(key, probabilities, count)])


def mask_indices(masks: Float[Array, "*batch n"]) -> Int[Array, "*batch"]:
    """Rows of `goal_masks` that masks [..., n] are, int32 [...]."""
    place = 2 ** np.arange(masks.shape[-1])[::-1]
    return (masks.astype(jnp.int32) * place).sum(axis=-1, dtype=jnp.int32)
