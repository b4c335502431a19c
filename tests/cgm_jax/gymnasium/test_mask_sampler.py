"""The mask sampler in numpy: by hand, by its definition, and against its twin in JAX."""

import itertools
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

from cgm_jax.curricula.parts.history import init_history, record_successes, subgoal_rates
from cgm_jax.curricula.parts.masks import goal_masks, mask_probabilities, mask_success_rates
from cgm_jax.gymnasium.mask_sampler import MaskSampler, mask_generator

CORNERS = list(itertools.product([0.0, 0.1, 0.5, 1.0], [0.0, 1.0, 32.0, 1000.0]))
"""Pairs of c_g and kappa."""


def seen(sampler: MaskSampler, *episodes: list[int]) -> MaskSampler:
    sampler.record(np.array(episodes))
    return sampler


def test_probabilities_worked_by_hand() -> None:
    # Rates 1/2 and 1/4; masks none, y, x, both: c_m = 1, 1/4, 1/2, 1/8, and c_g = 1/2.
    sampler = MaskSampler(2, c_g=0.5, kappa=1)
    seen(sampler, [1, 1], [1, 0], [0, 0], [0, 0])
    np.testing.assert_array_equal(sampler.masks, [[0, 0], [0, 1], [1, 0], [1, 1]])
    np.testing.assert_allclose(sampler.subgoal_rates, [0.5, 0.25])
    np.testing.assert_allclose(sampler.success_rates, [1, 0.25, 0.5, 0.125])
    weights = np.array([0.5, 0.75, 1.0, 0.625])
    np.testing.assert_allclose(sampler.probabilities, weights / 2.875)


@pytest.mark.parametrize("n", [3, 9])
def test_probabilities_are_those_in_jax(n: int) -> None:
    generator = np.random.default_rng(n)
    masks, history = goal_masks(n), init_history(10, n)
    samplers = {corner: MaskSampler(n, *corner) for corner in CORNERS}
    for count in (0, 4, 15):
        outcomes = generator.random((count, n)) < np.linspace(0.2, 1.0, n)
        if count:
            history = record_successes(history, jnp.asarray(outcomes), jnp.ones(count, bool))
        for (c_g, kappa), sampler in samplers.items():
            if count:
                sampler.record(outcomes)
            rates = mask_success_rates(masks, subgoal_rates(history, c_g))
            expected = mask_probabilities(rates, c_g, kappa)
            np.testing.assert_array_equal(sampler.masks, np.asarray(masks))
            np.testing.assert_allclose(sampler.success_rates, rates, atol=2e-6)
            # float32 in JAX: an error in c_m of 1e-7 grows with kappa.
            rtol = 2e-6 * (1 + kappa)
            np.testing.assert_allclose(sampler.probabilities, expected, rtol=rtol, atol=1e-8)
            assert sampler.probabilities.sum() == pytest.approx(1.0)


@pytest.mark.parametrize("n", [1, 3, 10])
def test_before_any_evaluation_the_full_goal_is_estimated_at_c_g(n: int) -> None:
    sampler = MaskSampler(n, c_g=0.3)
    np.testing.assert_allclose(sampler.subgoal_rates, 0.3 ** (1 / n))
    assert sampler.success_rates[-1] == pytest.approx(0.3)
    assert sampler.probabilities.argmax() == 2**n - 1


def test_rates_are_over_the_last_h_episodes() -> None:
    generator = np.random.default_rng(0)
    sampler, record = MaskSampler(3, history=10), []
    for count in (3, 4, 7, 25, 1):
        rows = generator.integers(0, 2, (count, 3))
        sampler.record(rows)
        record += list(rows)
        np.testing.assert_array_equal(sampler.outcomes, record[-10:])
        np.testing.assert_allclose(sampler.subgoal_rates, np.mean(record[-10:], axis=0))
    sampler.record([1, 0, 1])  # one episode
    np.testing.assert_array_equal(sampler.outcomes[-1], [1, 0, 1])
    assert len(sampler.outcomes) == 10


def test_masks_are_drawn_with_their_probabilities() -> None:
    sampler = seen(MaskSampler(2, c_g=0.5, kappa=3), [1, 1], [1, 0], [0, 0], [0, 0])
    generator = np.random.default_rng(0)
    draws = np.array([sampler.sample(generator) for _ in range(20_000)])
    counts = np.bincount(draws @ [2, 1], minlength=4)
    expected = 20_000 * sampler.probabilities
    assert np.sum((counts - expected) ** 2 / expected) < 16.27  # chi-squared, 3 degrees, 0.1 %


def test_where_every_weight_is_zero_masks_are_uniform() -> None:
    sampler = seen(MaskSampler(2, c_g=0.0, kappa=5), [1, 1])
    np.testing.assert_array_equal(sampler.probabilities, [0.25] * 4)


def test_the_generator_is_reproducible_and_not_the_environments_own() -> None:
    one, other = mask_generator(3).random(5), mask_generator(3).random(5)
    np.testing.assert_array_equal(one, other)
    assert (one != np.random.default_rng(3).random(5)).all()
    assert (one != mask_generator(4).random(5)).all()


def test_what_a_sampler_hands_out_is_not_its_own() -> None:
    sampler = MaskSampler(2)
    sampler.sample(np.random.default_rng(0))[:] = False
    sampler.probabilities[:] = 0.0
    assert sampler.masks[-1].all()
    assert sampler.probabilities.sum() == pytest.approx(1.0)


@pytest.mark.parametrize("mask_levels", [False, True])
def test_beyond_ten_dimensions_there_is_no_table_and_the_full_goal_is_estimated_at_c_g(
    mask_levels: bool,
) -> None:
    sampler = MaskSampler(11, c_g=0.3, kappa=1000.0, mask_levels=mask_levels)
    np.testing.assert_allclose(sampler.subgoal_rates.prod(), 0.3)
    assert sampler.full_goal_probability > 3 * 2**-11
    for name in ("masks", "success_rates", "probabilities"):
        with pytest.raises(ValueError, match="goals of 11 dimensions have too many masks"):
            getattr(sampler, name)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"goal_size": 0}, r"goal_size: 0 is not within \[1, 512\]"),
        ({"goal_size": 513}, r"goal_size: 513 is not within \[1, 512\]"),
        ({"mask_levels": 1}, "mask_levels: 1 is neither True nor False"),
        ({"c_g": 1.1}, r"c_g: 1.1 is not within \[0, 1\]"),
        ({"c_g": "0.1"}, "c_g: '0.1' is not a number"),
        ({"c_g": float("nan")}, "c_g: nan is not within"),
        ({"kappa": -1}, "kappa: -1 is not within"),
        ({"kappa": float("inf")}, "kappa: inf is not within"),
        ({"history": 0}, "history: 0 is not within"),
        ({"history": 2.5}, "history: 2.5 is not a whole number"),
    ],
)
def test_bad_arguments_are_refused_by_name(arguments: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        MaskSampler(**{"goal_size": 3, **arguments})


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        ([1, 0], r"shape \(2,\) is neither \(3,\) nor \(episodes, 3\)"),
        ([[[1, 0, 1]]], r"shape \(1, 1, 3\)"),
        ([1, 0, 0.5], "something else than 0 and 1"),
        ([1, 0, float("nan")], "something else than 0 and 1"),
    ],
)
def test_bad_outcomes_are_refused_and_change_nothing(rows: Any, message: str) -> None:
    sampler = seen(MaskSampler(3), [1, 0, 1])
    with pytest.raises(ValueError, match=message):
        sampler.record(rows)
    np.testing.assert_array_equal(sampler.outcomes, [[1, 0, 1]])
