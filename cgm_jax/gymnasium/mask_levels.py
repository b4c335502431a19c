"""Difficulty first: masks of many dimensions by levels of success, a method of this project.

The twin in numpy of curricula/parts/levels.py, which says why and explains the grid. A difficulty
is a success rate in whole percent; masks are counted by levels of -log c_m, where keeping dimension
k descends L_k = round(-log r_k / delta) levels and the last level is the end of difficulty 0. With
S_k(d) the share of the masks of k dimensions that descend exactly d levels, T_k(d) at least d,

    S_k(d) = (S_{k-1}(d) + S_{k-1}(d - L_k)) / 2,    S_0(0) = 1,
    T_k(d) = (T_{k-1}(d) + T_{k-1}(d - L_k)) / 2,    T_k(d <= 0) = 1.

Time and memory grow with n * LEVELS.
"""

import math

import numpy as np

from cgm_jax.gymnasium.mask_table import DIFFICULTIES, difficulty_first

LEVELS = 2048

DELTA = -math.log(0.5 / (DIFFICULTIES - 1)) / (LEVELS - 1)
"""Height of a level in -log c_m."""


class MaskLevels:
    """A difficulty c with p(c) proportional to (1 - |c - c_g|)^kappa, and a uniform mask of it."""

    def __init__(self, rates: np.ndarray, c_g: float, kappa: float) -> None:
        """Count the masks of every level.

        Args:
            rates: success rate of every sub-goal, [n] in [0, 1].
            c_g: the rate aimed at.
            kappa: sharpness.
        """
        with np.errstate(divide="ignore"):
            descents = np.minimum(np.round(-np.log(rates) / DELTA), LEVELS - 1)
        self._descents = descents.astype(int)
        self.shares = count_masks(self._descents)
        exactly, at_least = self.shares[-1].copy()
        exactly[-1] = at_least[-1]
        success_rates = np.exp(-DELTA * np.arange(LEVELS))
        success_rates[-1] = 0.0
        self._numbers = exactly
        self.probabilities = difficulty_first(success_rates, exactly, c_g, kappa)

    @property
    def full_goal_probability(self) -> float:
        """Probability of drawing the full goal: masks of one level are equally likely."""
        level = min(int(self._descents.sum()), LEVELS - 1)
        number = self._numbers[level] * 2.0 ** len(self._descents)
        return float(self.probabilities[level] / number)

    def draw(self, generator: np.random.Generator, count: int) -> np.ndarray:
        """Draw masks, [count, n] bool: a level, and then each dimension, from the last one back."""
        left = generator.choice(LEVELS, count, p=self.probabilities)
        kind = (left == LEVELS - 1).astype(int)
        uniform = generator.random((len(self._descents), count))
        masks = np.empty(uniform.shape, bool)
        for k in range(len(masks) - 1, -1, -1):
            rest = left - self._descents[k]
            ahead = np.maximum(rest, 0)
            masked = self.shares[k, kind, left]
            kept = np.where((rest >= 0) | (kind == 1), self.shares[k, kind, ahead], 0.0)
            masks[k] = uniform[k] * (kept + masked) < kept
            left = np.where(masks[k], ahead, left)
        return masks.T


def count_masks(descents: np.ndarray) -> np.ndarray:
    """Shares of the masks of the first k dimensions, by levels descended, [n + 1, 2, LEVELS].

    For k = 0, ..., n: the share that descends exactly d levels, S_k(d), and at least d, T_k(d).

    Args:
        descents: levels that keeping each dimension descends, [n] int, below `LEVELS`.
    """
    shares = np.zeros((len(descents) + 1, 2, LEVELS))
    shares[0, :, 0] = 1.0
    for k, descent in enumerate(descents):
        exactly, at_least = shares[k]
        kept = np.zeros((2, LEVELS))
        kept[0, descent:] = exactly[: LEVELS - descent]
        kept[1, descent:] = at_least[: LEVELS - descent]
        kept[1, :descent] = 1.0  # at least a negative number
        shares[k + 1] = 0.5 * (shares[k] + kept)
    return shares
