import functools
import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from cgm_jax.curricula.parts.levels import (
    DELTA,
    LEVELS,
    count_masks,
    difficulty_of,
    draw_masks_by_difficulty,
    level_probabilities,
    report_levels,
    walk_back,
)
from tests.cgm_jax.mask_oracles import all_masks, descents_of, difficulty_first_probabilities

draw = jax.jit(draw_masks_by_difficulty, static_argnames="count")
count = jax.jit(count_masks)
level_probability = jax.jit(level_probabilities)
LAST = LEVELS - 1

RATES = {
    "mixed": np.array([0.13, 0.97, 0.5, 0.5, 0.0, 1.0], np.float32),
    "hard": np.array([0.02, 0.3, 0.04, 0.6, 0.6, 0.6], np.float32),
    "never": np.zeros(6, np.float32),
    "always": np.ones(6, np.float32),
}
each_rates = pytest.mark.parametrize("rates", RATES.values(), ids=RATES)


@each_rates
def test_masks_are_counted_exactly(rates: np.ndarray) -> None:
    shares = np.asarray(count(rates))
    for k in range(len(rates) + 1):
        descended = descents_of(all_masks(k), rates[:k])
        exactly = np.bincount(descended, minlength=LEVELS) / 2**k
        np.testing.assert_array_equal(shares[k, 1], exactly[::-1].cumsum()[::-1])
        np.testing.assert_array_equal(shares[k, 0, :LAST], exactly[:LAST])


@pytest.mark.parametrize("kappa", [0.0, 4.0, 1000.0])
@each_rates
def test_a_level_has_the_probability_of_its_masks(rates: np.ndarray, kappa: float) -> None:
    masks = all_masks(len(rates))
    for c_g in (0.0, 0.1, 0.45, 1.0):
        probabilities = level_probability(count(rates)[-1], c_g, kappa)
        expected = np.zeros(LEVELS)
        np.add.at(
            expected,
            descents_of(masks, rates),
            difficulty_first_probabilities(masks, rates, c_g, kappa),
        )
        np.testing.assert_allclose(probabilities, expected, atol=1e-5)


def test_difficulties_by_hand() -> None:
    # c_m is 1, 0.5, 0 and 0: three difficulties, of closeness 0.5, 1 and 0.5.
    rates = jnp.array([0.5, 0.0])
    masks, estimates = draw(jax.random.key(0), rates, 0.5, 1.0, count=20_000)
    indices = np.asarray(2 * masks[:, 0] + masks[:, 1], int)
    shares = np.bincount(indices, minlength=4) / 20_000
    np.testing.assert_allclose(shares, [0.25, 0.125, 0.5, 0.125], atol=0.014)
    np.testing.assert_allclose(estimates, np.array([1, 0, 0.5, 0])[indices])


@each_rates
@pytest.mark.parametrize(("c_g", "kappa"), [(0.1, 4.0), (0.0, 1000.0), (0.8, 0.0)])
def test_masks_are_drawn_with_their_probabilities(
    rates: np.ndarray, c_g: float, kappa: float
) -> None:
    masks, estimates = draw(jax.random.key(1), rates, c_g, kappa, count=20_000)
    masks = np.asarray(masks, int)
    shares = np.bincount(masks @ 2 ** np.arange(len(rates))[::-1], minlength=2 ** len(rates))
    wanted = difficulty_first_probabilities(
        all_masks(len(rates)), rates, float(np.float32(c_g)), kappa
    )
    errors = np.sqrt(wanted / 20_000)
    assert (np.abs(shares / 20_000 - wanted) <= 4.5 * errors + 1e-5).all()
    products = np.prod(np.where(masks > 0, rates.astype(float), 1.0), axis=1)
    np.testing.assert_allclose(estimates, products, rtol=1e-5)


def test_walking_back_from_a_level_ends_at_a_mask_of_it() -> None:
    rates = np.random.default_rng(0).choice([0.0, 0.3, 0.7, 0.9, 0.97, 1.0], 64).astype(np.float32)
    shares = count(rates)
    some = np.flatnonzero(shares[-1, 0])
    levels = np.append(some[some < LAST], [LAST] * 20)
    uniform = jax.random.uniform(jax.random.key(2), (64, len(levels)))
    masks, _ = jax.jit(walk_back)(jnp.asarray(rates), shares, jnp.asarray(levels), uniform)
    np.testing.assert_array_equal(descents_of(np.asarray(masks), rates), levels)


def test_in_many_dimensions_success_is_where_it_is_aimed_at() -> None:
    # The paper's rule draws none of these masks (test_lookahead.py). Masks that keep equally many
    # dimensions are alike, so 31 masks have all difficulties.
    rates = np.full(30, 0.5, np.float32)
    level = descents_of(np.tri(31, 30, -1), rates)
    difficulties = np.unique(np.where(level == LAST, 0, np.round(100 * np.exp(-DELTA * level))))
    weights = (1 - np.abs(difficulties / 100 - 0.1)) ** 32
    expected = weights[(difficulties >= 5) & (difficulties <= 20)].sum() / weights.sum()
    assert expected > 0.65
    _, estimates = draw(jax.random.key(3), rates, 0.1, 32.0, count=20_000)
    near = np.mean((np.asarray(estimates) >= 0.05) & (np.asarray(estimates) <= 0.2))
    assert near == pytest.approx(expected, abs=0.014)  # four standard errors


def test_the_full_goal_comes_up_where_its_success_is_aimed_at() -> None:
    # As before any evaluation: the full goal has rate c_g, and is the only mask that low.
    rates = jnp.full(20, 0.1 ** (1 / 20))
    masks, _ = draw(jax.random.key(4), rates, 0.1, 1000.0, count=2000)
    assert float(masks.sum(axis=1).min()) >= 18
    assert float(jnp.mean(masks.all(axis=1))) > 0.04


def test_sixty_four_dimensions_of_every_rate() -> None:
    rates = np.linspace(0, 1, 64, dtype=np.float32)
    for c_g, kappa in itertools.product([0.0, 0.1, 0.6, 1.0], [0.0, 32.0, 1000.0]):
        masks, estimates = draw(jax.random.key(5), rates, c_g, kappa, count=16)
        assert set(np.unique(masks)) <= {0.0, 1.0}
        if kappa == 1000.0:
            np.testing.assert_allclose(estimates, c_g, atol=0.01)


def test_too_many_dimensions_are_refused() -> None:
    with pytest.raises(ValueError, match="goal_size: 121 is above 120"):
        count_masks(jnp.ones(121))


def test_runs_are_vmapped() -> None:
    keys = jax.random.split(jax.random.key(6), 3)
    rates = jnp.asarray(np.random.default_rng(0).random((3, 7)), jnp.float32)
    c_g, kappa = jnp.array([0.1, 0.5, 0.9]), jnp.array([1.0, 32.0, 1000.0])
    together = jax.vmap(functools.partial(draw, count=8))(keys, rates, c_g, kappa)
    for run in range(3):
        alone = draw(keys[run], rates[run], c_g[run], kappa[run], count=8)
        np.testing.assert_array_equal(together[0][run], alone[0])


def test_a_difficulty_is_a_success_rate_in_whole_percent() -> None:
    estimates = jnp.array([0.0, 0.0049, 0.0051, 0.014, 0.5, 0.9951, 1.0])
    np.testing.assert_array_equal(difficulty_of(estimates), [0, 0, 1, 1, 50, 100, 100])


def test_levels_are_reported_by_share_and_kept_dimensions() -> None:
    masks = jnp.array([[0, 0, 0], [1, 0, 1], [1, 1, 1], [0, 1, 0]], jnp.float32)
    report = report_levels(masks, jnp.array([1.0, 0.31, 0.29, 0.0]))
    expected = np.zeros(21)
    expected[[0, 6, 20]] = 0.25, 0.5, 0.25
    np.testing.assert_array_equal(report.probability, expected)
    assert np.isnan(report.kept_dimensions).sum() == 18
    np.testing.assert_array_equal(report.kept_dimensions[jnp.array([0, 6, 20])], [1, 2.5, 0])
