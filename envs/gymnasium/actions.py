"""Actions as the physics takes them."""

from typing import Any

import numpy as np


def checked_action(
    action: Any, shape: tuple[int, ...], unused: np.ndarray | None = None
) -> np.ndarray:
    """The action as float32, clipped to [-1, 1] as Gymnasium-Robotics does.

    Args:
        action: an array or nested sequence of numbers.
        shape: that it must have.
        unused: rows of a batch whose numbers have no part in anything; they become 0.

    Raises:
        ValueError: another shape, entries that are no real numbers, or not finite.
    """
    try:
        array = np.asarray(action)
    except ValueError as error:  # rows of different lengths
        raise ValueError(f"action: no array of shape {shape}: {error}") from None
    if array.shape != shape:
        raise ValueError(f"action: shape {array.shape} is not {shape}")
    if array.dtype.kind not in "iuf":
        raise ValueError(f"action: entries of type {array.dtype} are no real numbers")
    if unused is not None:
        array = np.where(unused[:, None], 0, array)
    for where in np.argwhere(~np.isfinite(array)):
        raise ValueError(f"action: {array[tuple(where)]} at {where.tolist()} is not finite")
    return np.clip(array, -1.0, 1.0).astype(np.float32)
