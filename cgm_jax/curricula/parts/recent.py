"""The last so many things of a kind: practised goals with their success, visited states."""

from typing import Any

import jax
import jax.numpy as jnp
from flax import struct
from jaxtyping import Array, Bool, Float, Shaped

from cgm_jax.config.missing import missing


class Recent(struct.PyTreeNode):
    """A ring of rows.

    Attributes:
        rows: any pytree, every leaf with a leading axis [N].
        recorded: how many rows were ever recorded, int32 scalar. Row i lies in slot i mod N.
    """

    rows: Any
    recorded: jax.Array

    @property
    def filled(self) -> Bool[Array, " N"]:
        """Which slots hold a row, [N] bool."""
        length = jax.tree.leaves(self.rows)[0].shape[0]
        return jnp.arange(length) < self.recorded


def init_recent(like: Any, length: int) -> Recent:
    """A ring that has seen nothing.

    Args:
        like: shapes and types of one row; keys of `jax.random` may be among them.
        length: how many rows it holds, N.
    """
    rows = jax.tree.map(lambda leaf: jnp.zeros((length, *leaf.shape), leaf.dtype), like)
    return Recent(rows, jnp.zeros((), jnp.int32))


def record(recent: Recent, rows: Any, valid: Bool[Array, " k"]) -> Recent:
    """Put the valid ones of some rows into the ring, in order, over the oldest.

    Args:
        recent: the ring, of N rows.
        rows: with a leading axis [k]; of more than N valid ones only the last N are kept.
        valid: [k] bool.
    """
    length = recent.filled.shape[0]
    count = valid.sum(dtype=jnp.int32)
    place = jnp.cumsum(valid, dtype=jnp.int32) - 1
    kept = valid & (place >= count - length)
    slots = jnp.where(kept, (recent.recorded + place) % length, length)  # outside: dropped
    return Recent(
        rows=jax.tree.map(
            lambda ring, new: ring.at[slots].set(new, mode="drop"), recent.rows, rows
        ),
        recorded=recent.recorded + count,
    )


def mean_of(recent: Recent, values: Shaped[Array, " N"]) -> Float[Array, ""]:
    """Mean of values [N] over the filled slots; NaN while there is none."""
    total = jnp.sum(jnp.where(recent.filled, values.astype(jnp.float32), 0.0))
    count = recent.filled.sum()
    return jnp.where(count > 0, total / jnp.maximum(count, 1).astype(total.dtype), missing())
