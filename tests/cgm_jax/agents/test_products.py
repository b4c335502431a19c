import json
import os
import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from cgm_jax.agents.products import product
from tests.cgm_jax.sweeps import ROOT

SHAPES = [(7,), (5, 7), (128, 7), (300, 7), (3, 100, 7)]
"""Inputs: one, few, a part, parts with a rest, and a batch of two axes."""


@pytest.mark.parametrize("shape", SHAPES)
def test_values_and_gradients_are_those_of_the_product(shape: tuple[int, ...]) -> None:
    generator = np.random.default_rng(0)
    sizes = (shape, (7, 4), (*shape[:-1], 4))
    inputs, weights, gradient = (jnp.asarray(generator.normal(size=size)) for size in sizes)
    value, backward = jax.vjp(product, inputs, weights)
    of_inputs, of_weights = backward(gradient)
    np.testing.assert_allclose(value, inputs @ weights, rtol=1e-5, atol=1e-5)
    np.testing.assert_allclose(of_inputs, gradient @ weights.T, rtol=1e-5, atol=1e-5)
    expected = np.einsum("bi,bo->io", inputs.reshape(-1, 7), gradient.reshape(-1, 4))
    np.testing.assert_allclose(of_weights, expected, rtol=1e-4, atol=1e-4)


@pytest.mark.slow
def test_updates_have_the_same_bits_on_any_number_of_threads() -> None:
    few, *more = (updates_on(threads) for threads in (2, 4, 16))
    assert len(set(few.values())) == len(few) == 19
    for digests in more:
        assert digests == few


def updates_on(threads: int) -> dict[str, str]:
    """Digests of updates in a process with so many threads."""
    result = subprocess.run(
        [sys.executable, "-m", "tests.cgm_jax.agents.on_threads"],
        cwd=ROOT,
        env={**os.environ, "PJRT_NPROC": str(threads)},
        check=True,
        capture_output=True,
        text=True,
    )
    return json.loads(result.stdout)
