import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from cgm_jax.curricula.masking import (
    apply_mask,
    empty_history,
    goal_masks,
    joint_success_rates,
    mask_probabilities,
    mask_success_rates,
    masked_distance,
    record_successes,
    sample_masks,
    subgoal_rates,
)

CORNERS = list(itertools.product([0.0, 0.1, 0.5, 1.0], [0.0, 1.0, 32.0, 1000.0]))
"""Pairs of c_g and kappa."""


def oracle_probabilities(rates: np.ndarray, c_g: float, kappa: float) -> np.ndarray:
    """p(m), in float64 and by the definition; 0 to the power of 0 is 1."""
    closeness = 1.0 - np.abs(rates.astype(np.float64) - c_g)
    weights = (closeness / (closeness.max() or 1.0)) ** kappa
    if not weights.any():
        weights[:] = 1.0
    return weights / weights.sum()


@pytest.mark.parametrize("n", range(1, 13))
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


@pytest.mark.parametrize("n", range(1, 13))
@pytest.mark.parametrize("rate", [0.0, 1.0])
def test_success_rates_are_exact_at_rates_zero_and_one(n: int, rate: float) -> None:
    rates = np.asarray(mask_success_rates(goal_masks(n), jnp.full(n, rate)))
    expected = np.full(2**n, rate)
    expected[0] = 1.0
    np.testing.assert_array_equal(rates, expected)


@pytest.mark.parametrize("n", range(1, 13))
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


def test_masked_goals_keep_the_goal_where_the_mask_does() -> None:
    goal, achieved = jnp.array([1.0, 2.0, 3.0]), jnp.array([7.0, 8.0, 9.0])
    masked = apply_mask(goal, jnp.array([1.0, 0.0, 1.0]), achieved)
    np.testing.assert_array_equal(masked, [1, 8, 3])
    np.testing.assert_array_equal(apply_mask(goal, jnp.ones(3), achieved), goal)
    np.testing.assert_array_equal(apply_mask(goal, jnp.zeros(3), achieved), achieved)


def test_masked_distance_is_over_kept_dimensions() -> None:
    goal, achieved = jnp.array([3.0, 5.0, 4.0]), jnp.array([0.0, 100.0, 0.0])
    assert float(masked_distance(goal, jnp.array([1.0, 0.0, 1.0]), achieved)) == 5.0
    assert float(masked_distance(goal, jnp.zeros(3), achieved)) == 0.0


@pytest.mark.parametrize("c_g", [0.0, 0.1, 0.8, 1.0])
@pytest.mark.parametrize("n", [1, 3, 12])
def test_before_any_evaluation_the_full_goal_is_estimated_at_c_g(c_g: float, n: int) -> None:
    rates = subgoal_rates(empty_history(10, n), c_g)
    full_goal = mask_success_rates(goal_masks(n), rates)[-1]
    assert float(full_goal) == pytest.approx(c_g, abs=1e-6)


def test_history_matches_a_list_of_the_last_h_valid_rollouts() -> None:
    generator = np.random.default_rng(0)
    history, record = empty_history(10, 3), []
    for count in (3, 4, 7, 25, 1):
        successes = generator.integers(0, 2, (count, 3))
        valid = generator.random(count) < 0.7
        history = record_successes(history, jnp.asarray(successes), jnp.asarray(valid))
        record += [row for row, ok in zip(successes, valid, strict=True) if ok]
        np.testing.assert_allclose(
            subgoal_rates(history, 0.1), np.mean(record[-10:], axis=0), rtol=1e-6
        )


def test_history_of_only_broken_rollouts_keeps_the_default() -> None:
    history = record_successes(empty_history(10, 2), jnp.ones((4, 2)), jnp.zeros(4, bool))
    np.testing.assert_allclose(subgoal_rates(history, 0.25), [0.5, 0.5])


def test_joint_rates_are_shares_of_rollouts_that_achieved_all_kept_dimensions() -> None:
    # x and y succeed together in two of four rollouts, and never alone: 0.5, not 0.25.
    outcomes = jnp.array([[1, 1, 0], [0, 0, 1], [1, 1, 1], [0, 0, 0]])
    history = record_successes(empty_history(10, 3), outcomes, jnp.ones(4, bool))
    rates = joint_success_rates(goal_masks(3), history, 0.1)
    np.testing.assert_allclose(rates, [1, 0.5, 0.5, 0.25, 0.5, 0.25, 0.5, 0.25])
    product = mask_success_rates(goal_masks(3), subgoal_rates(history, 0.1))
    assert float(product[-1]) == pytest.approx(0.125)


def test_joint_rates_start_as_the_product() -> None:
    rates = joint_success_rates(goal_masks(3), empty_history(10, 3), 0.125)
    np.testing.assert_allclose(rates, [1, 0.5, 0.5, 0.25, 0.5, 0.25, 0.25, 0.125], rtol=1e-6)


@pytest.mark.parametrize("dimension", [0, 2])
def test_joint_and_product_agree_on_single_dimensions(dimension: int) -> None:
    outcomes = np.random.default_rng(1).integers(0, 2, (7, 3))
    history = record_successes(empty_history(10, 3), jnp.asarray(outcomes), jnp.ones(7, bool))
    single = jnp.zeros((1, 3)).at[0, dimension].set(1.0)
    joint = joint_success_rates(single, history, 0.1)
    np.testing.assert_allclose(joint, outcomes[:, dimension].mean(keepdims=True), rtol=1e-6)
