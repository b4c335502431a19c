"""Runs whose networks diverge: found on the device, frozen there, and named on the host.

A run that diverges keeps the last networks that were sound and learns no more. The runs beside
it are rows of the same arrays and keep their bits.
"""

import jax
import jax.numpy as jnp

from cgm_jax.agents.ddpg import Agent

GREATEST_WEIGHT = 1e9
"""No network of normalised inputs has use for a weight beyond this."""

PARTS = ("actor", "critic", "optimiser")
"""What is watched; bit i of a failure is about PARTS[i]."""


def failure_of(agent: Agent) -> jax.Array:
    """What has diverged in an agent, as an int32 scalar: one bit per part, 0 if all is sound."""
    finite = float(jnp.finfo(jnp.float32).max)
    parts = (
        ((agent.actor, agent.target_actor), GREATEST_WEIGHT),
        ((agent.critic, agent.target_critic), GREATEST_WEIGHT),
        ((agent.actor_optimiser, agent.critic_optimiser), finite),
    )
    bits = [(1 << i) * ~_within(tree, limit) for i, (tree, limit) in enumerate(parts)]
    return jnp.stack(bits).sum(dtype=jnp.int32)


def freeze_if_failed(failure: jax.Array, old: Agent, new: Agent) -> tuple[jax.Array, Agent]:
    """Take the new agent if it is sound and the run has never failed, else stay with the old.

    Args:
        failure: of the run so far, 0 if there was none.
        old: the agent before some updates, sound.
        new: the agent after them.

    Returns:
        The run's failure from now on, and its agent.
    """
    failure = jnp.where(failure == 0, failure_of(new), failure)
    return failure, jax.tree.map(lambda one, other: jnp.where(failure == 0, one, other), new, old)


def describe_failure(failure: int) -> str:
    """A failure in words, such as "actor, critic not finite or beyond 1e+09"."""
    names = [name for i, name in enumerate(PARTS) if failure >> i & 1]
    return f"{', '.join(names)} not finite or beyond {GREATEST_WEIGHT:.0e}"


def _within(tree: object, limit: float) -> jax.Array:
    """Whether all numbers of a pytree are finite and at most `limit`; NaN compares false."""
    checks = [jnp.all(jnp.abs(leaf) <= limit) for leaf in jax.tree.leaves(tree)]
    return jnp.stack(checks).all()
