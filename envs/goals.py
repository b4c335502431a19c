"""Goals, masked goals, and when they are achieved (Eppe, Magg and Wermter 2019, section III).

A mask keeps (1) or masks (0) each goal dimension. A masked dimension counts as achieved.
"""

import jax.numpy as jnp
from jax.typing import ArrayLike
from jaxtyping import Array, Bool, Float


def apply_mask(
    goal: Float[Array, "*#batch n"],
    mask: Float[Array, "*#batch n"],
    achieved_goal: Float[Array, "*#batch n"],
) -> Float[Array, "*batch n"]:
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


def masked_distance(
    goal: Float[Array, "*#batch n"],
    mask: Float[Array, "*#batch n"],
    achieved_goal: Float[Array, "*#batch n"],
) -> Float[Array, "*batch"]:
    """Euclidean distance [...] from the achieved goal over the kept dimensions [..., n]."""
    return jnp.linalg.norm(apply_mask(goal, mask, achieved_goal) - achieved_goal, axis=-1)


def is_achieved(
    goal: Float[Array, "*#batch n"],
    mask: Float[Array, "*#batch n"],
    achieved_goal: Float[Array, "*#batch n"],
    threshold: ArrayLike,
) -> Bool[Array, "*batch"]:
    """Whether masked goals are achieved [...]; the threshold broadcasts against [...]."""
    return masked_distance(goal, mask, achieved_goal) < threshold
