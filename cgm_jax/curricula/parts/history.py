"""Success rates over the last h noise-free evaluation episodes, per sub-goal."""

import jax
import jax.numpy as jnp
from flax import struct
from jax.typing import ArrayLike
from jaxtyping import Array, Bool, Float, Shaped


class SuccessHistory(struct.PyTreeNode):
    """Outcomes of the last h evaluation rollouts, per sub-goal, or what else all of them tell of.

    Attributes:
        successes: [h, columns] of 0 and 1, the newest last.
        count: how many rows, counted from the last, are filled; int32 scalar.
    """

    successes: jax.Array
    count: jax.Array


def init_history(length: int, columns: int) -> SuccessHistory:
    """A history of the last `length` rollouts that has seen none."""
    return SuccessHistory(jnp.zeros((length, columns)), jnp.zeros((), jnp.int32))


def record_successes(
    history: SuccessHistory, successes: Shaped[Array, "k columns"], valid: Bool[Array, " k"]
) -> SuccessHistory:
    """Append evaluation rollouts; the oldest beyond the history's length drop out.

    Args:
        history: outcomes so far, of length h.
        successes: [k, columns], in the order in which they happened.
        valid: [k] bool; rollouts with broken physics are left out.
    """
    length = history.successes.shape[0]
    filled = jnp.arange(length) >= length - history.count
    successes = jnp.where(valid[:, None], successes.astype(history.successes.dtype), 0.0)
    rows = jnp.concatenate([history.successes, successes])
    counts = jnp.concatenate([filled, valid])
    newest_last = jnp.argsort(counts, stable=True)[-length:]
    return SuccessHistory(
        successes=rows[newest_last],
        count=jnp.minimum(history.count + valid.sum(dtype=jnp.int32), length),
    )


def success_rates(history: SuccessHistory, default: ArrayLike) -> Float[Array, " columns"]:
    """Success rate of every column over the history; `default` before any evaluation."""
    length = history.successes.shape[0]
    filled = jnp.arange(length) >= length - history.count
    total = jnp.sum(jnp.where(filled[:, None], history.successes, 0.0), axis=0)
    count = jnp.maximum(history.count, 1).astype(total.dtype)
    return jnp.where(history.count > 0, total / count, default)


def subgoal_rates(history: SuccessHistory, c_g: ArrayLike) -> Float[Array, " n"]:
    """Success rate [n] per sub-goal over the history.

    Before any evaluation it is c_g^(1/n), so that the full goal is estimated at c_g.
    """
    return success_rates(history, jnp.power(c_g, 1.0 / history.successes.shape[-1]))
