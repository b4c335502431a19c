"""All masks of a goal of few dimensions, with their probabilities, in numpy."""

import numpy as np

MAX_TABULATED = 10
"""Dimensions of a goal up to which all 2^n masks are held in a table."""

DIFFICULTIES = 101
"""Success rates in whole percent."""


class MaskTable:
    """A distribution of masks as a table.

    Attributes:
        masks: in binary order, the first dimension the highest bit, [2^n, n] bool, True where the
            dimension counts. Row 0 masks everything, the last row is the full goal.
        success_rates: c_m, as if sub-goals succeeded independently, [2^n].
        probabilities: of being drawn, [2^n].
    """

    def __init__(
        self, rates: np.ndarray, c_g: float, kappa: float, mask_levels: bool = False
    ) -> None:
        """Weigh all masks.

        Args:
            rates: success rate of every sub-goal, [n] in [0, 1]; n is at most 10.
            c_g: the rate aimed at.
            kappa: sharpness.
            mask_levels: draw a difficulty first, then a mask of that difficulty.
        """
        self.masks = all_masks(len(rates))
        self.success_rates = np.where(self.masks, rates, 1.0).prod(axis=1)
        if mask_levels:
            ones = np.ones(len(self.masks))
            self.probabilities = difficulty_first(self.success_rates, ones, c_g, kappa)
        else:
            self.probabilities = softmax(log_weights(self.success_rates, c_g, kappa))

    @property
    def full_goal_probability(self) -> float:
        """Probability of drawing the full goal."""
        return float(self.probabilities[-1])

    def draw(self, generator: np.random.Generator, count: int) -> np.ndarray:
        """Draw masks, [count, n] bool."""
        return self.masks[generator.choice(len(self.masks), count, p=self.probabilities)]


def all_masks(goal_size: int) -> np.ndarray:
    """All masks of a goal in binary order, [2^n, n] bool."""
    indices = np.arange(2**goal_size)[:, None]
    return ((indices >> np.arange(goal_size)[::-1]) & 1).astype(bool)


def log_weights(success_rates: np.ndarray, c_g: float, kappa: float) -> np.ndarray:
    """Log of (1 - |c_m - c_g|)^kappa for success rates [...]; -inf for a weight of 0.

    The paper prints |c_m - c_g|^kappa, which would prefer masks far from c_g; its text and the
    authors' program say near.
    """
    return log_power(1.0 - np.abs(success_rates - c_g), kappa)


def log_power(base: np.ndarray, exponent: float) -> np.ndarray:
    """Log of base^exponent, for bases [...] of at least 0; 0^0 is 1."""
    if exponent == 0:
        return np.zeros_like(base)
    with np.errstate(divide="ignore"):
        return exponent * np.log(base)


def softmax(logits: np.ndarray) -> np.ndarray:
    """Probabilities [m] for their unnormalised logarithms; uniform where all of these are -inf."""
    if not np.isfinite(logits).any():
        return np.full(len(logits), 1.0 / len(logits))
    weights = np.exp(logits - logits.max())
    return weights / weights.sum()


def difficulty_first(
    success_rates: np.ndarray, numbers: np.ndarray, c_g: float, kappa: float
) -> np.ndarray:
    """Probability of drawing kinds of masks [m] where a difficulty is drawn first.

    Difficulties that no mask has are left out; masks of one difficulty are equally likely.

    Args:
        success_rates: c_m of the masks of each kind, [m].
        numbers: how many there are of each kind, or their share, [m].
        c_g: the rate aimed at.
        kappa: sharpness.
    """
    difficulty = np.round(success_rates * (DIFFICULTIES - 1)).astype(int)
    of_difficulty = np.bincount(difficulty, numbers, DIFFICULTIES)
    logits = log_weights(np.linspace(0.0, 1.0, DIFFICULTIES), c_g, kappa)
    there = of_difficulty > 0
    probabilities = np.zeros(DIFFICULTIES)
    probabilities[there] = softmax(logits[there])
    return probabilities[difficulty] * numbers / np.where(there, of_difficulty, 1.0)[difficulty]
