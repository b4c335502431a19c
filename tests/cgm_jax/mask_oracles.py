"""What the samplers of masks, in JAX and in numpy, are held against: enumerations in float64."""

import itertools
import math

import numpy as np

LAST_LEVEL = 2047
DELTA = -math.log(0.005) / LAST_LEVEL
"""Of the grid of difficulties: the last level is c_m = 0.005."""

CORNERS = np.array(list(itertools.product([0, 0.1, 0.4, 0.8, 1], [0, 1, 4, 32, 1000])), np.float32)
"""Pairs of c_g and kappa, [25, 2]."""


def all_masks(size: int) -> np.ndarray:
    return np.array(list(itertools.product([0, 1], repeat=size)))


def paper_probabilities(
    masks: np.ndarray, rates: np.ndarray, c_g: float, kappa: float
) -> np.ndarray:
    """The paper's p(m), in float64 and by the definition; uniform where all weights are 0."""
    success_rates = np.prod(np.where(masks > 0, rates.astype(np.float64), 1.0), axis=1)
    closeness = 1.0 - np.abs(success_rates - c_g)
    weights = (closeness / (closeness.max() or 1.0)) ** kappa
    return weights / weights.sum() if weights.any() else np.full(len(masks), 1 / len(masks))


def after_all_candidates(proposed: np.ndarray, wanted: np.ndarray, candidates: int) -> np.ndarray:
    """Distribution of the last of so many candidates, by the transition matrix between masks."""
    excess = wanted / np.maximum(proposed, 1e-300)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        ratio = excess[None, :] / excess[:, None]
    accept = np.where(excess[:, None] > 0, np.minimum(1.0, ratio), 1.0)
    moves = accept * proposed[None, :]
    stays = 1.0 - moves.sum(axis=1)
    distribution = proposed
    for _ in range(candidates - 1):
        distribution = distribution @ moves + distribution * stays
    return distribution


def total_variation(one: np.ndarray, other: np.ndarray) -> float:
    return 0.5 * float(np.abs(one - other).sum())


def kinds_of_rates(size: int, generator: np.random.Generator) -> list[np.ndarray]:
    rates = [
        generator.random(size),
        generator.integers(0, 11, size) / 10,  # as after ten evaluation episodes; with ties
        generator.integers(0, 51, size) / 50,
        1 - 10 ** generator.uniform(-4, 0, size),
        10 ** generator.uniform(-4, 0, size),
        generator.choice([0.0, 0.5, 1.0], size),
        np.zeros(size),
        np.ones(size),
        np.full(size, 0.9),
    ]
    return [row.astype(np.float32) for row in rates]


def exact_success_rates(
    values: list[float], copies: int, c_g: float, kappa: float
) -> tuple[np.ndarray, np.ndarray]:
    """Every c_m and its probability where each of the rates is that of several dimensions.

    Masks that keep equally many dimensions of each rate are alike, so that counting them is enough.
    """
    kept = np.array(list(itertools.product(range(copies + 1), repeat=len(values))))
    number = np.array([math.comb(copies, k) for k in range(copies + 1)], float)[kept].prod(axis=1)
    success_rates = np.prod(np.array(values, np.float32).astype(float) ** kept, axis=1)
    weights = number * (1.0 - np.abs(success_rates - c_g)) ** kappa
    return success_rates, weights / weights.sum()


def descents_of(masks: np.ndarray, rates: np.ndarray) -> np.ndarray:
    """Levels that masks descend, rounded by dimension; at most the last."""
    with np.errstate(divide="ignore"):
        each = np.minimum(np.round(-np.log(rates.astype(float)) / DELTA), LAST_LEVEL)
    return np.minimum(masks @ each, LAST_LEVEL).astype(int)


def difficulty_first_probabilities(
    masks: np.ndarray, rates: np.ndarray, c_g: float, kappa: float
) -> np.ndarray:
    """p(m) of difficulty first, by counting all masks."""
    level = descents_of(masks, rates)
    difficulty = np.where(
        level == LAST_LEVEL, 0, np.round(100 * np.exp(-DELTA * level)).astype(int)
    )
    number = np.bincount(difficulty, minlength=101)
    closeness = np.where(number > 0, 1 - np.abs(np.arange(101) / 100 - c_g), 0.0)
    weights = (closeness / (closeness.max() or 1.0)) ** kappa * (number > 0)
    weights = weights if weights.any() else (number > 0).astype(float)
    return (weights / weights.sum() / np.maximum(number, 1))[difficulty]
