"""Kernel density estimates with a Gaussian kernel, as scikit-learn's `KernelDensity`.

Not `jax.scipy.stats.gaussian_kde`, whose kernel has the shape of the samples' covariance.
"""

import math

import jax
import jax.numpy as jnp
from jax.scipy.special import logsumexp
from jax.typing import ArrayLike
from jaxtyping import Array, Float


def log_density(
    points: Float[Array, "*points n"], samples: Float[Array, "m n"], bandwidth: ArrayLike
) -> Float[Array, "*points"]:
    """Logarithm of the density [...] at points [..., n] that samples [m, n] suggest.

        log (1 / m) sum_j N(x; x_j, bandwidth^2 I)

    Finite however far a point is from all samples.
    """
    count, dimensions = samples.shape
    squares = _squares(points, samples, bandwidth)
    return logsumexp(-0.5 * squares, axis=-1) - _log_constant(count, dimensions, bandwidth)


def log_density_of_others(samples: Float[Array, "m n"], bandwidth: ArrayLike) -> Float[Array, " m"]:
    """Logarithm of the density [m] at each sample [m, n] that the other samples suggest, m > 1.

    What a sample adds to the density at its own place says nothing of how dense it is there.
    """
    count, dimensions = samples.shape
    squares = _squares(samples, samples, bandwidth)
    squares = jnp.where(jnp.eye(count, dtype=bool), jnp.inf, squares)
    return logsumexp(-0.5 * squares, axis=-1) - _log_constant(count - 1, dimensions, bandwidth)


def _squares(points: jax.Array, samples: jax.Array, bandwidth: ArrayLike) -> jax.Array:
    """Squared distances [..., m] in bandwidths."""
    return jnp.sum(jnp.square((points[..., None, :] - samples) / bandwidth), axis=-1)


def _log_constant(count: int, dimensions: int, bandwidth: ArrayLike) -> jax.Array:
    return math.log(count) + dimensions * (0.5 * math.log(2 * math.pi) + jnp.log(bandwidth))
