"""Numbers that do not exist yet, such as a mean of nothing; metrics.jsonl has null for them."""

import jax
import jax.numpy as jnp


def missing() -> float:
    """NaN; but minus infinity while JAX searches for NaN, which must not find this one.

    Both compare as no success rate does, and both are written as null.
    """
    return -jnp.inf if jax.config.jax_debug_nans else jnp.nan  # pyright: ignore
