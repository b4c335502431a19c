"""Runs whose networks diverge: found on the device, frozen there, and named on the host.

A run that diverges keeps the last networks that were finite and learns no more. The runs beside
it are rows of the same arrays and keep their bits.
"""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp

MAX_WEIGHT = 1e9
"""No network of normalised inputs has use for a weight beyond this."""

OPTIMISER = "optimiser"
"""Fields whose names end so may hold more: squares of gradients."""


def failure_of(agent: Any) -> jax.Array:
    """What has diverged in an agent's state, as an int32 scalar: one bit per field, 0 if none.

    Bit i is about the i-th field of its class.
    """
    finite = float(jnp.finfo(jnp.float32).max)
    bits = []
    for i, name in enumerate(_fields(agent)):
        limit = finite if name.endswith(OPTIMISER) else MAX_WEIGHT
        bits.append(jnp.where(_within(getattr(agent, name), limit), 0, 1 << i))
    return jnp.stack(bits).sum(dtype=jnp.int32)


def freeze_if_failed(
    failure: jax.Array, old: Any, new: Any, learned: jax.Array
) -> tuple[jax.Array, Any]:
    """Take the new agent if it is finite and the run has never failed, else stay with the old.

    Args:
        failure: of the run so far, 0 if there was none.
        old: the agent's state before some updates.
        new: the state after them.
        learned: whether there was anything to learn from; if not, the old agent stays, too.

    Returns:
        The run's failure from now on, and its agent's state.
    """
    failure = jnp.where((failure == 0) & learned, failure_of(new), failure)
    taken = (failure == 0) & learned
    return failure, jax.tree.map(lambda one, other: jnp.where(taken, one, other), new, old)


def describe_failure(failure: int, agent: Any) -> str:
    """A failure in words, such as "actor, critic not finite or beyond 1e+09"."""
    names = [name for i, name in enumerate(_fields(agent)) if failure >> i & 1]
    return f"{', '.join(names)} not finite or beyond {MAX_WEIGHT:.0e}"


def _fields(agent: Any) -> list[str]:
    return [item.name for item in dataclasses.fields(agent)]


def _within(tree: object, limit: float) -> jax.Array:
    """Whether all real numbers of a pytree are finite and at most `limit`; NaN compares false."""
    leaves = [leaf for leaf in jax.tree.leaves(tree) if jnp.issubdtype(leaf.dtype, jnp.inexact)]
    checks = [jnp.all(jnp.abs(leaf) <= limit) for leaf in leaves]
    return jnp.stack(checks).all() if checks else jnp.ones((), bool)
