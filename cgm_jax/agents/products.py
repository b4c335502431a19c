"""A dense layer's matrix products, whose bits do not depend on how many threads compute them.

On a CPU XLA shares the blocks of a product out among its threads. Where the first factor is
transposed it leaves the product to Eigen, which also cuts the sum, where there are fewer blocks
than threads, into more parts the more threads there are. Gradients of weights are such products,
over a minibatch: a run's bits would depend on the number of cores. So here the factor is transposed
first, as an array of its own, which takes no longer there. A GPU is left alone.
"""

from typing import Any

import jax
from jaxtyping import Array, Float


@jax.custom_vjp
def product(
    inputs: Float[Array, "*batch inputs"], weights: Float[Array, "inputs outputs"]
) -> Float[Array, "*batch outputs"]:
    """`inputs @ weights`, with the same gradients on any number of threads.

    It has no forward derivatives (`jax.jvp`, `jax.jacfwd`).

    Args:
        inputs: [..., inputs].
        weights: [inputs, outputs].
    """
    return inputs @ weights


def _forward(inputs: jax.Array, weights: jax.Array) -> tuple[jax.Array, Any]:
    return inputs @ weights, (inputs, weights)


def _backward(saved: Any, gradient: jax.Array) -> tuple[jax.Array, jax.Array]:
    inputs, weights = saved
    of_weights = jax.lax.platform_dependent(
        _rows(inputs),
        _rows(gradient),
        cpu=lambda inputs, gradient: jax.lax.optimization_barrier(inputs.T) @ gradient,
        default=lambda inputs, gradient: inputs.T @ gradient,
    )
    return gradient @ weights.T, of_weights


product.defvjp(_forward, _backward)


def _rows(array: jax.Array) -> jax.Array:
    return array.reshape(-1, array.shape[-1])
