"""Rewards and ends of episodes, from achieved and desired goals in metres.

All take one pair of goals [3] or a batch of them [..., 3], as HER's relabelling needs it.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

GOAL_SIZE = 3


def is_achieved(
    achieved_goal: np.ndarray, desired_goal: np.ndarray, threshold: float
) -> np.ndarray | np.bool_:
    """Whether goals [..., 3] are achieved, [...].

    Raises:
        ValueError: the goals are not [..., 3], or do not fit each other.
    """
    achieved, desired = np.asarray(achieved_goal, float), np.asarray(desired_goal, float)
    for name, goal in (("achieved_goal", achieved), ("desired_goal", desired)):
        if goal.shape[-1:] != (GOAL_SIZE,):
            raise ValueError(f"{name}: shape {goal.shape} is not (..., {GOAL_SIZE})")
    return np.linalg.norm(achieved - desired, axis=-1) < threshold


def sparse_reward(
    achieved_goal: np.ndarray, desired_goal: np.ndarray, threshold: float
) -> np.ndarray | np.float64:
    """0 where goals [..., 3] are achieved, -1 elsewhere, [...] float64.

    Raises:
        ValueError: as `is_achieved`.
    """
    return np.where(is_achieved(achieved_goal, desired_goal, threshold), 0.0, -1.0)[()]


def physics_broke(info: Mapping[str, Any] | Sequence[Mapping[str, Any]] | None) -> Any:
    """Whether `step`'s information tells of broken physics: a bool, or [n] for n of them.

    None tells of nothing.
    """
    if info is None:
        return False
    if isinstance(info, Mapping):
        broke = np.greater(info.get("physics_warnings", 0), 0)
        return broke if np.ndim(broke) else bool(broke)
    return np.array([physics_broke(one) for one in info], bool)
