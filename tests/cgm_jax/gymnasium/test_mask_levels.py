"""Difficulty first in numpy, against counting all masks and against its twin in JAX."""

import itertools

import jax.numpy as jnp
import numpy as np
import pytest

from cgm_jax.curricula.parts import levels as in_jax
from cgm_jax.gymnasium.mask_levels import LEVELS, MaskLevels
from cgm_jax.gymnasium.mask_lookahead import MaskLookahead
from cgm_jax.gymnasium.mask_sampler import MaskSampler
from cgm_jax.gymnasium.mask_table import MaskTable
from tests.cgm_jax.mask_oracles import (
    LAST_LEVEL,
    all_masks,
    descents_of,
    difficulty_first_probabilities,
    total_variation,
)

RATES = {
    "mixed": np.array([0.13, 0.97, 0.5, 0.5, 0.0, 1.0]),
    "hard": np.array([0.02, 0.3, 0.04, 0.6, 0.6, 0.6]),
    "never": np.zeros(6),
    "always": np.ones(6),
}
AIMS = list(itertools.product([0.0, 0.1, 0.45, 1.0], [0.0, 4.0, 1000.0]))
"""Pairs of c_g and kappa."""

each_rates = pytest.mark.parametrize("rates", RATES.values(), ids=RATES)


@each_rates
def test_a_level_has_the_probability_of_its_masks(rates: np.ndarray) -> None:
    masks = all_masks(6)
    level = descents_of(masks, rates)
    for c_g, kappa in AIMS:
        levels = MaskLevels(rates, c_g, kappa)
        expected, wanted = (
            np.zeros(LEVELS),
            difficulty_first_probabilities(masks, rates, c_g, kappa),
        )
        np.add.at(expected, level, wanted)
        np.testing.assert_allclose(levels.probabilities, expected, atol=1e-12)
        assert levels.full_goal_probability == pytest.approx(wanted[-1], abs=1e-12)


def test_masks_are_counted_as_in_jax() -> None:
    rates = np.random.default_rng(0).integers(0, 11, 20) / 10
    ours = MaskLevels(rates, 0.1, 4.0)
    np.testing.assert_allclose(ours.shares, in_jax.count_masks(jnp.asarray(rates)), rtol=1e-6)


@each_rates
def test_masks_are_drawn_with_their_probabilities(rates: np.ndarray) -> None:
    masks = MaskLevels(rates, 0.1, 4.0).draw(np.random.default_rng(0), 20_000)
    shares = np.bincount(masks @ 2 ** np.arange(6)[::-1], minlength=64) / 20_000
    wanted = difficulty_first_probabilities(all_masks(6), rates, 0.1, 4.0)
    assert (np.abs(shares - wanted) <= 4.5 * np.sqrt(wanted / 20_000)).all()


@pytest.mark.parametrize("size", [3, 10])
def test_the_table_draws_a_difficulty_first_as_well(size: int) -> None:
    # Rates of few values, no mask of which lies where rounding decides its difficulty.
    rates = np.resize([0.5, 1.0, 0.21], size)
    for c_g, kappa in AIMS:
        wanted = difficulty_first_probabilities(all_masks(size), rates, c_g, kappa)
        table = MaskTable(rates, c_g, kappa, mask_levels=True)
        assert total_variation(table.probabilities, wanted) <= 0.02
    sampler = MaskSampler(2, c_g=0.5, kappa=1.0, mask_levels=True)
    sampler.record([[1, 0], [0, 0]])
    # c_m is 1, 0, 0.5 and 0: three difficulties, of closeness 0.5, 0.5 and 1.
    np.testing.assert_allclose(sampler.probabilities, [0.25, 0.125, 0.5, 0.125])


def test_in_thirty_dimensions_success_is_where_it_is_aimed_at() -> None:
    def near(distribution: MaskLevels | MaskLookahead) -> float:
        kept = distribution.draw(np.random.default_rng(0), 20_000).sum(axis=1)
        return float(np.mean((0.5**kept >= 0.05) & (0.5**kept <= 0.2)))

    # Masks that keep equally many dimensions are alike, so 31 masks have all difficulties.
    rates = np.full(30, 0.5)
    level = descents_of(np.tri(31, 30, -1), rates)
    step = -np.log(0.005) / LAST_LEVEL
    difficulties = np.unique(
        np.where(level == LAST_LEVEL, 0, np.round(100 * np.exp(-step * level)))
    )
    weights = (1 - np.abs(difficulties / 100 - 0.1)) ** 32
    expected = weights[(difficulties >= 5) & (difficulties <= 20)].sum() / weights.sum()
    assert expected > 0.65
    near_aim = near(MaskLevels(rates, 0.1, 32.0))
    assert near_aim == pytest.approx(expected, abs=0.014)  # four standard errors
    assert near(MaskLookahead(rates, 0.1, 32.0)) < 0.01


@pytest.mark.parametrize("kappa", [0.0, 32.0, 1000.0])
@pytest.mark.parametrize("c_g", [0.0, 0.1, 1.0])
def test_five_hundred_and_twelve_dimensions_of_every_rate(c_g: float, kappa: float) -> None:
    rates = np.linspace(0, 1, 512)
    levels, generator = MaskLevels(rates, c_g, kappa), np.random.default_rng(0)
    assert levels.probabilities.sum() == pytest.approx(1.0)
    for mask in levels.draw(generator, 3):
        if kappa == 1000.0:
            assert rates[mask].prod() == pytest.approx(c_g, abs=0.02)
