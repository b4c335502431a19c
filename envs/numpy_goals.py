"""When goals are achieved, and the reward for it, in numpy: for what has no JAX in its process."""

import numpy as np
from numpy.typing import ArrayLike


def is_achieved(
    achieved_goal: ArrayLike, desired_goal: ArrayLike, threshold: ArrayLike
) -> np.ndarray | np.bool_:
    """Whether goals [..., n] are closer to each other than the threshold, [...]."""
    return np.linalg.norm(difference(achieved_goal, desired_goal), axis=-1) < threshold


def sparse_reward(achieved: np.ndarray | np.bool_) -> np.ndarray | np.float64:
    """0 where goals are achieved, -1 elsewhere; of [...] bool [...] float64."""
    return np.where(achieved, 0.0, -1.0)[()]


def difference(achieved_goal: ArrayLike, desired_goal: ArrayLike) -> np.ndarray:
    """From desired to achieved goals [..., n], float64."""
    return np.asarray(achieved_goal, np.float64) - np.asarray(desired_goal, np.float64)
