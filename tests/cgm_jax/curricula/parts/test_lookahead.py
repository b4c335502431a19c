import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from cgm_jax.curricula.parts.lookahead import CANDIDATES, draw_masks, propose
from tests.cgm_jax.mask_oracles import (
    CORNERS,
    after_all_candidates,
    all_masks,
    exact_success_rates,
    kinds_of_rates,
    paper_probabilities,
    total_variation,
)

draw = jax.jit(draw_masks, static_argnames="count")


@jax.jit
def log_probabilities(rates: jax.Array, corners: jax.Array, masks: jax.Array) -> jax.Array:
    regardless = jnp.where(masks.T > 0, -1.0, 2.0)
    return jax.lax.map(lambda c: propose(rates, c[0], c[1], regardless).log_probability, corners)


def proposed(rates: np.ndarray, corners: np.ndarray = CORNERS) -> np.ndarray:
    """Probability of proposing each mask at each corner, [corners, 2^n]; no sampling noise."""
    return np.exp(np.asarray(log_probabilities(rates, corners, all_masks(len(rates))), np.float64))


@pytest.mark.parametrize("size", [1, 4, 10])
def test_masks_have_the_papers_probabilities(size: int) -> None:
    masks = all_masks(size)
    for rates in kinds_of_rates(size, np.random.default_rng(size)):
        rows = proposed(rates)
        np.testing.assert_allclose(rows.sum(axis=1), 1.0, atol=1e-5)
        for row, (c_g, kappa) in zip(rows, CORNERS.astype(float), strict=True):
            wanted = paper_probabilities(masks, rates, c_g, kappa)
            distance = total_variation(row, wanted)
            if distance > 0.005:  # further candidates never increase it
                distance = total_variation(after_all_candidates(row, wanted, CANDIDATES), wanted)
            assert distance <= 0.005, (rates, c_g, kappa)


def test_where_peaks_are_sharp_candidates_are_what_makes_probabilities_right() -> None:
    # Two masks keep a single 0.8, which is c_g itself, and the peak lies between two levels.
    rates = np.array([0.7, 0.8, 0.3, 0.6, 0.8], np.float32)
    corner = np.array([[0.8, 1000.0]], np.float32)
    [row], wanted = (
        proposed(rates, corner),
        paper_probabilities(all_masks(5), rates, *corner[0].astype(float)),
    )
    assert total_variation(row, wanted) > 0.1
    assert total_variation(after_all_candidates(row, wanted, CANDIDATES), wanted) < 0.005

    drawn, _ = draw(jax.random.key(0), rates, *corner[0], count=20_000)
    indices = np.asarray(drawn, int) @ (2 ** np.arange(5)[::-1])
    shares = np.bincount(indices, minlength=32) / 20_000
    np.testing.assert_allclose(shares, wanted, atol=0.014)  # four standard errors


@pytest.mark.parametrize(("c_g", "kappa"), [(0.1, 32.0), (0.8, 32.0), (0.4, 1000.0)])
def test_success_rates_of_thirty_dimensions_are_distributed_as_counted(
    c_g: float, kappa: float
) -> None:
    values, edges = [0.0, 0.3, 0.6, 0.8, 0.95, 1.0], np.linspace(-0.0123, 1.0377, 43)
    rates = np.random.default_rng(0).permutation(np.array(np.repeat(values, 5), np.float32))
    success_rates, weights = exact_success_rates(values, 5, float(np.float32(c_g)), kappa)
    expected = np.histogram(success_rates, edges, weights=weights)[0]
    _, estimates = draw(jax.random.key(0), rates, c_g, kappa, count=10_000)
    shares = np.histogram(np.asarray(estimates), edges)[0] / 10_000
    assert total_variation(shares, expected) < 0.03  # sampling alone: up to 0.025
    # Without weights masks are elsewhere.
    success_rates, weights = exact_success_rates(values, 5, c_g, 0.0)
    uniform = np.histogram(success_rates, edges, weights=weights)[0]
    assert total_variation(uniform, expected) > 0.02


@pytest.mark.parametrize(("size", "share"), [(3, 0.96), (12, 0.55), (30, 0.0)])
def test_the_papers_rule_misses_its_aim_in_many_dimensions(size: int, share: float) -> None:
    _, estimates = draw(jax.random.key(1), jnp.full(size, 0.5), 0.1, 32.0, count=10_000)
    near = np.mean((np.asarray(estimates) >= 0.05) & (np.asarray(estimates) <= 0.2))
    assert near == pytest.approx(share, abs=0.02)  # four standard errors


def test_the_full_goal_of_six_dimensions_is_rare() -> None:
    masks, _ = draw(jax.random.key(2), jnp.full(6, 0.5), 0.1, 32.0, count=20_000)
    assert float(jnp.mean(masks.all(axis=1))) == pytest.approx(0.004, abs=0.0015)


def test_kappa_of_zero_is_uniform() -> None:
    for rates in kinds_of_rates(5, np.random.default_rng(0)):
        np.testing.assert_allclose(proposed(rates)[CORNERS[:, 1] == 0], 1 / 32, rtol=1e-5)


@pytest.mark.parametrize("kappa", [1.0, 1000.0])
def test_masks_of_weight_zero_are_not_drawn_and_where_all_are_masks_are_uniform(
    kappa: float,
) -> None:
    rates = jnp.array([1.0, 1.0, 0.4, 1.0])  # without the third dimension c_m = 1, so weight 0
    masks, estimates = draw(jax.random.key(3), rates, 0.0, kappa, count=20_000)
    np.testing.assert_allclose(masks.mean(axis=0), [0.5, 0.5, 1.0, 0.5], atol=0.015)
    np.testing.assert_allclose(estimates, 0.4)
    masks, _ = draw(jax.random.key(3), jnp.ones(4), 0.0, kappa, count=20_000)
    np.testing.assert_allclose(masks.mean(axis=0), 0.5, atol=0.015)


@pytest.mark.parametrize("kappa", [0.0, 1.0, 1000.0])
@pytest.mark.parametrize("c_g", [0.0, 0.5, 1.0])
def test_sixty_four_dimensions_with_rates_of_zero_and_one(c_g: float, kappa: float) -> None:
    rates = np.linspace(0, 1, 64, dtype=np.float32)
    masks, estimates = (np.asarray(x) for x in draw(jax.random.key(4), rates, c_g, kappa, count=16))
    assert set(np.unique(masks)) <= {0.0, 1.0}
    products = np.prod(np.where(masks > 0, rates.astype(float), 1.0), axis=1)
    np.testing.assert_allclose(estimates, products, rtol=1e-5, atol=1e-30)
    if kappa == 1000.0 and c_g > 0.0:
        np.testing.assert_allclose(estimates, c_g, atol=0.01)


def test_runs_are_vmapped() -> None:
    keys = jax.random.split(jax.random.key(5), 3)
    rates = jnp.asarray(np.random.default_rng(0).random((3, 7)), jnp.float32)
    c_g, kappa = jnp.array([0.1, 0.5, 0.9]), jnp.array([1.0, 32.0, 1000.0])
    together = jax.vmap(functools.partial(draw, count=8))(keys, rates, c_g, kappa)
    for run in range(3):
        alone = draw(keys[run], rates[run], c_g[run], kappa[run], count=8)
        np.testing.assert_array_equal(together[0][run], alone[0])
