"""The mask sampler of curriculum goal masking, in numpy.

The twin of the one in JAX that this project trains with, for programs that have no JAX in their
process; a test holds the two together. Eppe, Magg and Wermter (2019), section III.
"""

import math
from numbers import Integral, Real

import numpy as np
from numpy.typing import ArrayLike

from cgm_jax.gymnasium.mask_levels import MaskLevels
from cgm_jax.gymnasium.mask_lookahead import MaskLookahead
from cgm_jax.gymnasium.mask_table import MAX_TABULATED, MaskTable

MAX_GOAL_SIZE = 512
"""Shares of masks of down to 2^-n are float64."""


class MaskSampler:
    """Draws masks whose estimated success is near a chosen rate, from what evaluations showed.

    All masks are held in a table up to ten dimensions, see mask_table.py; beyond, they are drawn
    from the same distribution without one, see mask_lookahead.py and mask_levels.py.

    Attributes:
        goal_size: number of goal dimensions n.
    """

    def __init__(
        self,
        goal_size: int,
        c_g: float = 0.1,
        kappa: float = 32.0,
        history: int = 10,
        mask_levels: bool = False,
    ) -> None:
        """Make a sampler that has seen no evaluation.

        Args:
            goal_size: number of goal dimensions n, at most 512.
            c_g: the success rate aimed at, in [0, 1].
            kappa: sharpness, 0 (uniform) to 10^6.
            history: h, how many of the latest evaluation episodes count.
            mask_levels: draw a difficulty first, then a mask of that difficulty: a method of this
                project, for goals of many dimensions, nearly all of whose masks are far from c_g.

        Raises:
            ValueError: an argument out of its range.
        """
        _check_number("goal_size", goal_size, 1, MAX_GOAL_SIZE, Integral)
        _check_number("c_g", c_g, 0, 1, Real)
        _check_number("kappa", kappa, 0, 1e6, Real)
        _check_number("history", history, 1, 10**6, Integral)
        check_switch("mask_levels", mask_levels)
        self.goal_size = int(goal_size)
        self._c_g, self._kappa, self._history = float(c_g), float(kappa), int(history)
        self._mask_levels = mask_levels
        self._outcomes = np.zeros((0, self.goal_size), bool)
        self._distribution = self._make_distribution()

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
    def masks(self) -> np.ndarray:
        """All masks in binary order, the first dimension the highest bit; [2^n, n] bool.

        True where the dimension counts. Row 0 masks everything, the last row is the full goal.

        Raises:
            ValueError: a goal of more than ten dimensions has too many.
        """
        return self._table().masks.copy()

    @property
    def success_rates(self) -> np.ndarray:
        """c_m, estimated success of every mask, as if sub-goals succeeded independently; [2^n].

        Raises:
            ValueError: as `masks`.
        """
        return self._table().success_rates.copy()

    @property
    def probabilities(self) -> np.ndarray:
        """p(m), proportional to (1 - |c_m - c_g|)^kappa unless a difficulty is drawn first; [2^n].

        Raises:
            ValueError: as `masks`.
        """
        return self._table().probabilities.copy()

    @property
    def full_goal_probability(self) -> float:
        """Probability of drawing the full goal, of many dimensions nearly (mask_lookahead.py)."""
        return self._distribution.full_goal_probability

    def record(self, subgoal_success: ArrayLike) -> None:
        """Add evaluation episodes: the full goal, no exploration noise.

        Args:
            subgoal_success: whether each sub-goal was achieved at the episode's last step, 0 or 1;
                [n] for one episode or [k, n] for several, the newest last.

        Raises:
            ValueError: another shape, or something else than 0 and 1.
        """
        rows = np.atleast_2d(np.asarray(subgoal_success))
        goal_size = self.goal_size
        if rows.ndim != 2 or rows.shape[1] != goal_size:
            raise ValueError(
                f"subgoal_success: shape {np.shape(subgoal_success)} is neither ({goal_size},) "
                f"nor (episodes, {goal_size})"
            )
        if not np.isin(rows, (0, 1)).all():
            raise ValueError("subgoal_success: holds something else than 0 and 1")
        self._outcomes = np.concatenate([self._outcomes, rows.astype(bool)])[-self._history :]
        self._distribution = self._make_distribution()

    def sample(self, generator: np.random.Generator) -> np.ndarray:
        """Draw a mask, [n] bool."""
        return self._distribution.draw(generator, 1)[0]

    def _make_distribution(self) -> MaskTable | MaskLookahead | MaskLevels:
        aim = (self.subgoal_rates, self._c_g, self._kappa)
        if self.goal_size <= MAX_TABULATED:
            return MaskTable(*aim, self._mask_levels)
        return MaskLevels(*aim) if self._mask_levels else MaskLookahead(*aim)

    def _table(self) -> MaskTable:
        if not isinstance(self._distribution, MaskTable):
            raise ValueError(
                f"goals of {self.goal_size} dimensions have too many masks for a table, which "
                f"serves up to {MAX_TABULATED}"
            )
        return self._distribution


def mask_generator(seed: int | None) -> np.random.Generator:
    """Random numbers for masks, independent of an environment's own under the same seed."""
    return np.random.default_rng(np.random.SeedSequence(seed).spawn(1)[0])


def check_switch(name: str, value: object) -> None:
    """Check that a switch is on or off.

    Raises:
        ValueError: it is something else.
    """
    if not isinstance(value, bool):
        raise ValueError(f"{name}: {value!r} is neither True nor False")


def _check_number(name: str, value: float, low: float, high: float, kind: type) -> None:
    if not isinstance(value, kind) or isinstance(value, bool):
        raise ValueError(f"{name}: {value!r} is not a {'whole ' if kind is Integral else ''}number")
    if not (math.isfinite(value) and low <= value <= high):
        raise ValueError(f"{name}: {value} is not within [{low:g}, {high:g}]")
