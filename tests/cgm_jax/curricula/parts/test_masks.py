import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from cgm_jax.curricula.parts.masks import (
    goal_masks,
    mask_indices,
    mask_probabilities,
    mask_success_rates,
    sample_masks,
)

pytestmark = pytest.mark.usefixtures("strict")

CORNERS = list(itertools.product([0.0, 0.1, 0.5, 1.0], [0.0, 1.0, 32.0, 1000.0]))
"""Pairs of c_g and kappa."""

SIZES = (1, 2, 3, 10)
"""Of goals, up to the largest that has a table of masks."""


def oracle_probabilities(rates: np.ndarray, c_g: float, kappa: float) -> np.ndarray:
    """p(m), in float64 and by the definition; 0 to the power of 0 is 1."""
    closeness = 1.0 - np.abs(rates.astype(np.float64) - c_g)
    weights = (closeness / (closeness.max() or 1.0)) ** kappa
    if not weights.any():
        weights[:] = 1.0
    return weights / weights.sum()


@pytest.mark.parametrize("n", SIZES)
def test_masks_come_in_binary_order_with_the_first_dimension_as_the_highest_bit(n: int) -> None:
    masks = np.asarray(goal_masks(n))
    assert masks.shape == (2**n, n)
    expected = np.array(list(itertools.product([0, 1], repeat=n)))
    np.testing.assert_array_equal(masks, expected)


def test_masks_of_no_dimension_are_refused() -> None:
    with pytest.raises(ValueError, match="goal_size: 0"):
        goal_masks(0)


def test_success_rates_are_products_over_kept_dimensions() -> None:
    rates = mask_success_rates(goal_masks(3), jnp.array([0.5, 0.2, 0.1]))
    np.testing.assert_allclose(rates, [1, 0.1, 0.2, 0.02, 0.5, 0.05, 0.1, 0.01], rtol=1e-6)


@pytest.mark.parametrize("n", SIZES)
@pytest.mark.parametrize("rate", [0.0, 1.0])
def test_success_rates_are_exact_at_rates_zero_and_one(n: int, rate: float) -> None:
    rates = np.asarray(mask_success_rates(goal_masks(n), jnp.full(n, rate)))
    expected = np.full(2**n, rate)
    expected[0] = 1.0
    np.testing.assert_array_equal(rates, expected)


@pytest.mark.parametrize("n", SIZES)
def test_probabilities_match_the_oracle_at_every_corner(n: int) -> None:
    subgoals = np.stack([np.zeros(n), np.ones(n), np.linspace(0.05, 0.95, n)]).astype(np.float32)
    masks = goal_masks(n)
    for rates in np.asarray(jax.vmap(lambda rate: mask_success_rates(masks, rate))(subgoals)):
        c_g, kappa = jnp.array(CORNERS, jnp.float32).T
        drawn = np.asarray(
            jax.vmap(mask_probabilities, (None, 0, 0))(jnp.asarray(rates), c_g, kappa)
        )
        assert np.isfinite(drawn).all()
        np.testing.assert_allclose(drawn.sum(axis=1), 1.0, atol=1e-5)
        expected = [oracle_probabilities(rates, float(np.float32(c)), k) for c, k in CORNERS]
        np.testing.assert_allclose(drawn, expected, atol=2e-4)


def test_probabilities_by_hand() -> None:
    # Closeness 0.5, 0.9, 1.0; squared 0.25, 0.81, 1.0, which sum to 2.06.
    probabilities = mask_probabilities(jnp.array([0.6, 0.2, 0.1]), 0.1, 2.0)
    np.testing.assert_allclose(probabilities, np.array([0.25, 0.81, 1.0]) / 2.06, rtol=1e-5)


def test_a_mask_at_the_far_end_is_never_drawn() -> None:
    # With c_g = 0 the all-zero mask, which always succeeds, has probability exactly 0.
    rates = mask_success_rates(goal_masks(3), jnp.array([0.2, 0.3, 0.9]))
    assert float(mask_probabilities(rates, 0.0, 1.0)[0]) == 0.0


def test_masks_are_drawn_as_often_as_their_probabilities_say() -> None:
    probabilities = jnp.array([0.0, 0.1, 0.3, 0.6])
    drawn = np.asarray(sample_masks(jax.random.key(0), probabilities, 20_000))
    shares = np.bincount(drawn, minlength=4) / 20_000
    assert shares[0] == 0.0
    np.testing.assert_allclose(shares, probabilities, atol=0.015)  # four standard errors


@pytest.mark.parametrize("n", [1, 3, 10])
def test_indices_are_rows_of_the_table(n: int) -> None:
    masks = goal_masks(n)
    shuffled = np.random.default_rng(0).permutation(2**n)
    np.testing.assert_array_equal(mask_indices(masks[shuffled]), shuffled)
