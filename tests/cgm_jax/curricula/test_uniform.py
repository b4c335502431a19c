"""Uniform masks."""

import jax
import jax.numpy as jnp
import numpy as np

from cgm_jax.curricula.parts.masks import mask_indices
from cgm_jax.curricula.protocol import Goals, View
from cgm_jax.curricula.uniform import Uniform
from tests.cgm_jax.curricula.small import sizes

VIEW = View(None, jnp.zeros(()), jnp.zeros(()), lambda *_: jnp.zeros(1), lambda *_: jnp.zeros(1))


def test_all_masks_are_reported_as_equally_likely_where_they_are_few() -> None:
    report = Uniform().report(Uniform().init(sizes(3)))
    np.testing.assert_array_equal(report["mask_probability"], np.full(8, 0.125))
    assert len(Uniform().init(sizes(10))) == 1024
    assert Uniform().report(Uniform().init(sizes(11))) == {}


def test_all_masks_are_drawn_alike() -> None:
    count = 100_000
    drawn = Goals(jnp.zeros((count, 3)), jnp.ones((count, 3)), jnp.ones(count))
    masks = Uniform().sample(jnp.zeros(8), jax.random.key(0), drawn, VIEW).mask
    shares = jnp.bincount(mask_indices(masks), length=8) / count
    np.testing.assert_allclose(shares, 0.125, atol=0.0045)  # four standard errors
