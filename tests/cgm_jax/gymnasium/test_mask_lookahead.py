"""The paper's distribution in many dimensions, in numpy, against its table and against counting."""

import numpy as np
import pytest

from cgm_jax.gymnasium.mask_lookahead import CANDIDATES, MaskLookahead
from cgm_jax.gymnasium.mask_sampler import MaskSampler
from cgm_jax.gymnasium.mask_table import MaskTable
from tests.cgm_jax.mask_oracles import (
    CORNERS,
    after_all_candidates,
    all_masks,
    exact_success_rates,
    kinds_of_rates,
    paper_probabilities,
    total_variation,
)


def proposed(lookahead: MaskLookahead, masks: np.ndarray) -> np.ndarray:
    """Probability of proposing each mask; no sampling noise."""
    return np.exp(lookahead.propose(np.where(masks.T > 0, -1.0, 2.0)).log_probability)


@pytest.mark.parametrize("size", [1, 4, 10])
def test_masks_have_the_probabilities_of_the_table(size: int) -> None:
    masks = all_masks(size)
    for rates in kinds_of_rates(size, np.random.default_rng(size)):
        for c_g, kappa in CORNERS.astype(float):
            table = MaskTable(rates.astype(float), c_g, kappa)
            wanted = paper_probabilities(masks, rates, c_g, kappa)
            np.testing.assert_allclose(table.probabilities, wanted, rtol=1e-6, atol=1e-12)
            lookahead = MaskLookahead(rates.astype(float), c_g, kappa)
            row = proposed(lookahead, masks)
            assert row.sum() == pytest.approx(1.0)
            assert lookahead.full_goal_probability == pytest.approx(row[-1])
            distance = total_variation(row, wanted)
            if distance > 0.005:  # further candidates never increase it
                distance = total_variation(after_all_candidates(row, wanted, CANDIDATES), wanted)
            assert distance <= 0.005, (rates, c_g, kappa)


def test_where_peaks_are_sharp_candidates_are_what_makes_probabilities_right() -> None:
    rates = np.array([0.7, 0.8, 0.3, 0.6, 0.8])
    lookahead = MaskLookahead(rates, 0.8, 1000.0)
    wanted = paper_probabilities(all_masks(5), rates, 0.8, 1000.0)
    assert total_variation(proposed(lookahead, all_masks(5)), wanted) > 0.1
    indices = lookahead.draw(np.random.default_rng(0), 10_000) @ (2 ** np.arange(5)[::-1])
    shares = np.bincount(indices, minlength=32) / 10_000
    np.testing.assert_allclose(shares, wanted, atol=0.02)  # four standard errors


@pytest.mark.parametrize(("c_g", "kappa"), [(0.1, 32.0), (0.4, 1000.0)])
def test_success_rates_of_thirty_dimensions_are_distributed_as_counted(
    c_g: float, kappa: float
) -> None:
    values, edges = [0.0, 0.3, 0.6, 0.8, 0.95, 1.0], np.linspace(-0.0123, 1.0377, 43)
    rates = np.random.default_rng(0).permutation(np.repeat(values, 5))
    success_rates, weights = exact_success_rates(values, 5, c_g, kappa)
    expected = np.histogram(success_rates, edges, weights=weights)[0]
    masks = MaskLookahead(rates, c_g, kappa).draw(np.random.default_rng(0), 10_000)
    products = np.where(masks, rates, 1.0).prod(axis=1)
    shares = np.histogram(products, edges)[0] / 10_000
    assert total_variation(shares, expected) < 0.03  # sampling alone: up to 0.025
    # Without weights masks are elsewhere.
    success_rates, weights = exact_success_rates(values, 5, c_g, 0.0)
    uniform = np.histogram(success_rates, edges, weights=weights)[0]
    assert total_variation(uniform, expected) > 0.03


@pytest.mark.parametrize("kappa", [1.0, 1000.0])
def test_where_every_weight_is_zero_masks_are_uniform(kappa: float) -> None:
    lookahead = MaskLookahead(np.ones(12), 0.0, kappa)
    assert lookahead.full_goal_probability == pytest.approx(2.0**-12)
    np.testing.assert_allclose(
        lookahead.draw(np.random.default_rng(0), 4000).mean(axis=0), 0.5, atol=0.035
    )


@pytest.mark.parametrize("kappa", [0.0, 1.0, 1000.0])
@pytest.mark.parametrize("c_g", [0.0, 0.5, 1.0])
def test_sixty_four_dimensions_with_rates_of_zero_and_one(c_g: float, kappa: float) -> None:
    sampler = MaskSampler(64, c_g, kappa, history=63)
    sampler.record(np.tri(63, 64, -1)[:, ::-1])  # rates of 0, 1/63, ..., 62/63, and again 0
    sampler.record(np.ones(64))
    rates = sampler.subgoal_rates
    assert rates.min() == pytest.approx(1 / 63)
    assert rates.max() == 1.0
    masks = np.array([sampler.sample(np.random.default_rng(i)) for i in range(16)])
    assert masks.shape == (16, 64)
    if kappa == 1000.0 and c_g > 0.0:
        products = np.where(masks, rates, 1.0).prod(axis=1)
        np.testing.assert_allclose(products, c_g, atol=0.01)
