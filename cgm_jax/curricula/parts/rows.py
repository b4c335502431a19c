"""Rows of two pytrees, such as the states of many environments."""

from typing import TypeVar

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool

Tree = TypeVar("Tree")


def where_rows(condition: Bool[Array, " E"], yes: Tree, no: Tree) -> Tree:
    """Each row [E] of one pytree where a condition holds, else of another of the same shapes.

    Unlike `jnp.where`, also for keys of `jax.random`, and for leaves of any number of axes.
    """
    pick = jax.vmap(lambda chosen, one, other: jnp.where(chosen, one, other))
    return jax.tree.map(lambda one, other: pick(condition, one, other), yes, no)
