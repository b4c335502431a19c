"""Rewards and ends of episodes, from achieved and desired goals in metres."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from cgm_jax.envs.numpy_goals import is_achieved, sparse_reward

GOAL_SIZE = 3


def reward_of(
    achieved_goal: np.ndarray, desired_goal: np.ndarray, threshold: float
) -> np.ndarray | np.float64:
    """0 where goals [..., 3] are achieved, -1 elsewhere, [...] float64.

    One pair of goals [3] or a batch of them, as HER's relabelling needs it.

    Raises:
        ValueError: the goals are not [..., 3], or do not fit each other.
    """
    for name, goal in (("achieved_goal", achieved_goal), ("desired_goal", desired_goal)):
        if np.shape(goal)[-1:] != (GOAL_SIZE,):
            raise ValueError(f"{name}: shape {np.shape(goal)} is not (..., {GOAL_SIZE})")
    return sparse_reward(is_achieved(achieved_goal, desired_goal, threshold))


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
