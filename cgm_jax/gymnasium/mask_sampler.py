"""The mask sampler of curriculum goal masking, in numpy.

The twin of the one in JAX that this project trains with, for programs that have no JAX in their
process; a test holds the two together. Eppe, Magg and Wermter (2019), section III.
"""

import math
from numbers import Integral, Real

import numpy as np
from numpy.typing import ArrayLike

MAX_GOAL_SIZE = 12
"""Goals of at most this many dimensions: all 2^n masks are held in a table."""


class MaskSampler:
    """Draws masks whose estimated success is near a chosen rate, from what evaluations showed.

    Attributes:
        masks: all masks in binary order, the first dimension the highest bit; [2^n, n] bool, True
            where the dimension counts. Row 0 masks everything, the last row is the full goal.
    """

    def __init__(
        self, goal_size: int, c_g: float = 0.1, kappa: float = 32.0, history: int = 10
    ) -> None:
        """Make a sampler that has seen no evaluation.

        Args:
            goal_size: number of goal dimensions n.
            c_g: the success rate aimed at, in [0, 1].
            kappa: sharpness, 0 (uniform) to 10^6.
            history: h, how many of the latest evaluation episodes count.

        Raises:
            ValueError: an argument out of its range.
        """
        _check_number("goal_size", goal_size, 1, MAX_GOAL_SIZE, Integral)
        _check_number("c_g", c_g, 0, 1, Real)
        _check_number("kappa", kappa, 0, 1e6, Real)
        _check_number("history", history, 1, 10**6, Integral)
        self.masks = _all_masks(goal_size)
        self._c_g, self._kappa, self._history = float(c_g), float(kappa), int(history)
        self._outcomes = np.zeros((0, goal_size), bool)
        self._probabilities = self._compute_probabilities()

    @property
    def outcomes(self) -> np.ndarray:
        """Evaluation episodes that count, the newest last: [at most h, n] bool."""
        return self._outcomes.copy()

    @property
    def subgoal_rates(self) -> np.ndarray:
        """Success rate of every sub-goal, [n]; c_g^(1/n) before any evaluation.

        That default puts the estimate of the full goal at c_g.
        """
        count, goal_size = self._outcomes.shape
        if count == 0:
            return np.full(goal_size, self._c_g ** (1.0 / goal_size))
        return self._outcomes.mean(axis=0)

    @property
    def success_rates(self) -> np.ndarray:
        """c_m, estimated success of every mask, as if sub-goals succeeded independently; [2^n]."""
        return np.where(self.masks, self.subgoal_rates, 1.0).prod(axis=1)

    @property
    def probabilities(self) -> np.ndarray:
        """p(m), proportional to (1 - |c_m - c_g|)^kappa, [2^n].

        The paper prints |c_m - c_g|^kappa, which would prefer masks far from c_g; its text and
        the authors' program say near.
        """
        return self._probabilities.copy()

    def record(self, subgoal_success: ArrayLike) -> None:
        """Add evaluation episodes: the full goal, no exploration noise.

        Args:
            subgoal_success: whether each sub-goal was achieved at the episode's last step, 0 or 1;
                [n] for one episode or [k, n] for several, the newest last.

        Raises:
            ValueError: another shape, or something else than 0 and 1.
        """
        rows = np.atleast_2d(np.asarray(subgoal_success))
        goal_size = self.masks.shape[1]
        if rows.ndim != 2 or rows.shape[1] != goal_size:
            raise ValueError(
                f"subgoal_success: shape {np.shape(subgoal_success)} is neither ({goal_size},) "
                f"nor (episodes, {goal_size})"
            )
        if not np.isin(rows, (0, 1)).all():
            raise ValueError("subgoal_success: holds something else than 0 and 1")
        self._outcomes = np.concatenate([self._outcomes, rows.astype(bool)])[-self._history :]
        self._probabilities = self._compute_probabilities()

    def sample(self, generator: np.random.Generator) -> np.ndarray:
        """Draw a mask, [n] bool."""
        index = generator.choice(len(self.masks), p=self._probabilities)
        return self.masks[index].copy()

    def _compute_probabilities(self) -> np.ndarray:
        """In log space, so that no kappa underflows; uniform where every weight is 0."""
        closeness = 1.0 - np.abs(self.success_rates - self._c_g)
        logits = np.zeros_like(closeness)
        if self._kappa > 0 and closeness.any():
            with np.errstate(divide="ignore"):
                logits = self._kappa * np.log(closeness)
        weights = np.exp(logits - logits.max())
        return weights / weights.sum()


def mask_generator(seed: int | None) -> np.random.Generator:
    """Random numbers for masks, independent of an environment's own under the same seed."""
    return np.random.default_rng(np.random.SeedSequence(seed).spawn(1)[0])


def _all_masks(goal_size: int) -> np.ndarray:
    indices = np.arange(2**goal_size)[:, None]
    return ((indices >> np.arange(goal_size)[::-1]) & 1).astype(bool)


def _check_number(name: str, value: float, low: float, high: float, kind: type) -> None:
    if not isinstance(value, kind) or isinstance(value, bool):
        raise ValueError(f"{name}: {value!r} is not a {'whole ' if kind is Integral else ''}number")
    if not (math.isfinite(value) and low <= value <= high):
        raise ValueError(f"{name}: {value} is not within [{low:g}, {high:g}]")
