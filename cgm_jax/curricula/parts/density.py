"""Kernel density estimates with a Gaussian kernel, as scikit-learn's `KernelDensity`.

Not `jax.scipy.stats.gaussian_kde`, whose kernel has the shape of the samples' covariance.
"""

import math

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
    dimensions = samples.shape[-1]
    squares = jnp.sum(jnp.square((points[..., None, :] - samples) / bandwidth), axis=-1)
    normaliser = dimensions * (0.5 * math.log(2 * math.pi) + jnp.log(bandwidth))
    return logsumexp(-0.5 * squares, axis=-1) - math.log(samples.shape[0]) - normaliser
