"""Uniform masks."""

import jax.numpy as jnp
import numpy as np

from cgm_jax.curricula.uniform import Uniform
from tests.cgm_jax.curricula.small import Chances, epochs, sizes
from tests.cgm_jax.probe import tiny


def test_all_masks_are_reported_as_equally_likely_where_they_are_few() -> None:
    report = Uniform().report(Uniform().init(sizes(3)))
    np.testing.assert_array_equal(report["mask_probability"], np.full(8, 0.125))
    assert len(Uniform().init(sizes(10))) == 1024
    assert Uniform().report(Uniform().init(sizes(11))) == {}


def test_training_practises_all_masks_alike_whatever_succeeds() -> None:
    run = epochs(Chances(), tiny(curriculum="uniform"))
    shares = jnp.stack([next(run)[1]["mask_share"] for _ in range(4)])
    np.testing.assert_allclose(shares.sum(axis=1), 1.0, rtol=1e-6)
    # 512 episodes: a share of 1/8 has a standard error of 0.015.
    np.testing.assert_allclose(shares.mean(axis=0), 0.125, atol=0.06)
