import math
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from cgm_jax.config.fields import stack
from cgm_jax.curricula.cgm import CGM, CGMState, joint_success_rates
from cgm_jax.curricula.parts.history import (
    SuccessHistory,
    init_history,
    record_successes,
    subgoal_rates,
)
from cgm_jax.curricula.parts.masks import goal_masks, mask_success_rates
from cgm_jax.curricula.protocol import Goals, Outcomes
from cgm_jax.loop.training import make_trainer
from tests.cgm_jax.curricula.small import Chances, epochs, sizes
from tests.cgm_jax.probe import TINY, tiny
from tests.cgm_jax.protocols import assert_no_type_is_promoted


def test_joint_rates_are_shares_of_rollouts_that_achieved_all_kept_dimensions() -> None:
    # x and y succeed together in two of four rollouts, and never alone: 0.5, not 0.25.
    outcomes = jnp.array([[1, 1, 0], [0, 0, 1], [1, 1, 1], [0, 0, 0]])
    history = record_successes(init_history(10, 3), outcomes, jnp.ones(4, bool))
    rates = joint_success_rates(goal_masks(3), history, 0.1)
    np.testing.assert_allclose(rates, [1, 0.5, 0.5, 0.25, 0.5, 0.25, 0.5, 0.25])
    product = mask_success_rates(goal_masks(3), subgoal_rates(history, 0.1))
    assert float(product[-1]) == pytest.approx(0.125)


def test_joint_rates_start_as_the_product() -> None:
    rates = joint_success_rates(goal_masks(3), init_history(10, 3), 0.125)
    np.testing.assert_allclose(rates, [1, 0.5, 0.5, 0.25, 0.5, 0.25, 0.25, 0.125], rtol=1e-6)


def test_a_mask_is_measured_by_the_last_of_its_own_episodes_that_count() -> None:
    """Two dimensions, four masks; three rounds of all masks, in which some physics broke."""
    curriculum = CGM(c_g=0.25, masked_evaluation_episodes=3, success_history=2)
    success = jnp.array([[1, 0, 0, 1], [1, 0, 0, 1], [1, 1, 1, 0]], bool)
    valid = jnp.array([[1, 1, 0, 0], [1, 1, 0, 1], [1, 0, 0, 1]], bool)
    known = sizes(2)
    episodes = outcomes_of(success.reshape(-1), valid.reshape(-1), curriculum.examination(known))
    nothing = outcomes_of(jnp.zeros(1, bool), jnp.zeros(1, bool), jnp.ones((1, 2)))
    state = curriculum.after_evaluation(curriculum.init(known), nothing, episodes)
    # Of the third mask nothing is known: its estimate stays, 0.25^(1/2).
    np.testing.assert_allclose(curriculum.rates(state), [1.0, 0.0, 0.5, 0.5])
    state = curriculum.after_evaluation(state, nothing, episodes)
    assert state.masks is not None
    np.testing.assert_array_equal(state.masks.inserted, [6, 4, 0, 4])
    swapped = episodes.replace(success=~episodes.success)
    state = curriculum.after_evaluation(state, nothing, swapped)
    np.testing.assert_allclose(curriculum.rates(state), [0.0, 1.0, 0.5, 0.5])


def outcomes_of(success: jax.Array, valid: jax.Array, masks: Any) -> Outcomes:
    """Of episodes with these masks [P, n]; their goals do not matter."""
    return Outcomes(
        goals=Goals(desired=jnp.zeros(masks.shape), mask=masks, threshold=jnp.ones(len(masks))),
        success=success,
        subgoal_success=jnp.zeros(masks.shape, bool),
        valid=valid,
        observation=jnp.zeros((len(masks), 1)),
    )


@pytest.mark.parametrize("dimension", [0, 2])
def test_joint_and_product_agree_on_single_dimensions(dimension: int) -> None:
    outcomes = np.random.default_rng(1).integers(0, 2, (7, 3))
    history = record_successes(init_history(10, 3), jnp.asarray(outcomes), jnp.ones(7, bool))
    single = jnp.zeros((1, 3)).at[0, dimension].set(1.0)
    joint = joint_success_rates(single, history, 0.1)
    np.testing.assert_allclose(joint, outcomes[:, dimension].mean(keepdims=True), rtol=1e-6)


def test_a_share_of_full_goals_is_forced_and_the_rest_drawn_as_before() -> None:
    rates = jnp.array([1.0, 0.5, 0.4, 0.2])
    plain = CGM(c_g=0.4, kappa=4.0).probabilities(rates)
    forced = CGM(c_g=0.4, kappa=4.0, full_share=0.25).probabilities(rates)
    np.testing.assert_allclose(forced, 0.75 * plain + 0.25 * np.array([0, 0, 0, 1]), rtol=1e-6)
    none = CGM(c_g=0.4, kappa=4.0, full_share=0.0).probabilities(rates)
    np.testing.assert_array_equal(none, plain)


@pytest.mark.parametrize("c_g", [0.0, 0.5, 1.0])
def test_without_sharpness_masks_are_drawn_uniformly_whatever_succeeds(c_g: float) -> None:
    curriculum = CGM(c_g=c_g, kappa=0.0)
    # Rates at which 1 - |c_m - c_g| is 0 are among them, and all at once.
    for rates in (np.linspace(0.0, 1.0, 8), np.zeros(8), np.ones(8)):
        probabilities = curriculum.probabilities(jnp.asarray(rates, jnp.float32))
        np.testing.assert_allclose(probabilities, 0.125, rtol=1e-6)
    many = init_history(10, 12)
    certain = jnp.tile(jnp.arange(12) % 2, (10, 1))  # rates of 0 and 1
    history = record_successes(many, certain, jnp.ones(10, bool))
    masks, _ = curriculum.draw(CGMState(history), jax.random.key(0), 8000)
    np.testing.assert_allclose(masks.mean(axis=0), 0.5, atol=0.023)  # four standard errors
    kept = np.bincount(np.asarray(masks.sum(axis=1), int), minlength=13) / 8000
    expected = np.array([math.comb(12, k) for k in range(13)]) / 2**12
    np.testing.assert_allclose(kept, expected, atol=0.02)


def test_training_without_sharpness_practises_all_masks_alike() -> None:
    run = epochs(Chances(), tiny(curriculum="cgm", c_g=1.0, kappa=0.0))
    shares = np.stack([next(run)[1]["mask_share"] for _ in range(4)])
    np.testing.assert_allclose(shares.sum(axis=1), 1.0, rtol=1e-6)
    np.testing.assert_allclose(shares.mean(axis=0), 0.125, atol=0.06)  # four, of 512 episodes


def test_settings_are_leaves_where_traced_and_structure_where_static() -> None:
    assert len(jax.tree.leaves(CGM())) == 3
    one, other = (jax.tree.structure(CGM(success_history=h)) for h in (10, 50))
    assert one != other
    assert jax.tree.structure(CGM(c_g=0.3)) == one


@pytest.mark.parametrize(
    "values", [{"masked_evaluation_episodes": 1}, {"factorised": False}, {"mask_levels": True}]
)
def test_no_type_is_promoted_with_any_of_its_estimates(values: dict[str, Any]) -> None:
    hyper = stack([tiny(curriculum="cgm", **values)])
    assert_no_type_is_promoted(make_trainer(Chances(), TINY), hyper)


@pytest.mark.parametrize("mask_levels", [False, True])
def test_no_type_is_promoted_in_many_dimensions(mask_levels: bool) -> None:
    curriculum = stack([CGM(c_g=0.1, kappa=4.0, mask_levels=mask_levels)])
    curriculum = jax.tree.map(lambda leaf: leaf[0], curriculum)
    with jax.numpy_dtype_promotion("strict"):
        state = jax.eval_shape(lambda: curriculum.init(sizes(12)))
        jax.eval_shape(curriculum.report, state)


@pytest.mark.parametrize("full_share", [0.0, 0.5])
@pytest.mark.parametrize(("aim", "near"), [(1.0, [0, 4]), (0.5, [1, 5]), (0.0, [2, 3, 6, 7])])
def test_training_practises_masks_near_the_success_rate_aimed_at(
    aim: float, near: list[int], full_share: float
) -> None:
    # The first sub-goal always succeeds, the second never, the third half of the time.
    hyper = tiny(curriculum="cgm", c_g=aim, kappa=1000.0, full_share=full_share)
    run = epochs(Chances(), hyper)
    next(run)
    shares = np.mean([next(run)[1]["mask_share"] for _ in range(4)], axis=0)
    expected = np.zeros(8)
    expected[near] = (1 - full_share) / len(near)
    expected[7] += full_share
    assert shares.sum() == pytest.approx(1.0)
    np.testing.assert_array_equal(shares > 0, expected > 0)
    np.testing.assert_allclose(shares, expected, atol=0.09)  # four standard errors of 512 episodes


def test_beyond_a_table_the_report_has_full_goals_at_their_own_success() -> None:
    successes = jnp.tile((jnp.arange(10) < 9)[:, None], (1, 12)).astype(jnp.float32)
    state = CGMState(SuccessHistory(successes, jnp.asarray(10)))
    report = CGM(c_g=0.9, kappa=32.0, full_share=1.0).report(state)
    # All draws are the full goal, which is estimated at 0.9^12 = 0.28, nearest to 0.3.
    np.testing.assert_allclose(report["level_probability"], np.arange(21) == 6)
    assert float(report["level_kept_dimensions"][6]) == 12.0
