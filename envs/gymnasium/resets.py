"""What a reset may be asked for: seeds, options and masks. Checked before anything changes."""

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from gymnasium.error import Error
from gymnasium.utils import seeding


def check_options(options: Mapping[str, Any] | None, known: Iterable[str] = ()) -> None:
    """Check the options of a reset.

    Raises:
        TypeError: they are neither a mapping nor None.
        ValueError: one has no effect.
    """
    if options is None:
        return
    if not isinstance(options, Mapping):
        raise TypeError(f"options: {options!r} is neither a dict nor None")
    if unknown := [name for name in options if name not in known]:
        raise ValueError(f"options: {unknown[0]!r} has no effect here")


def rows_to_reset(options: Mapping[str, Any] | None, num_envs: int) -> np.ndarray:
    """Which rows [n] a reset is for: those of `options["reset_mask"]`, else all.

    The conventions are those of Gymnasium's own vector environments.

    Raises:
        TypeError: the options are no mapping, or the mask is no array of bool.
        ValueError: the mask is not [n] or names no row; another option was given.
    """
    check_options(options, known=("reset_mask",))
    if options is None or "reset_mask" not in options:
        return np.ones(num_envs, bool)
    mask = options["reset_mask"]
    if not isinstance(mask, np.ndarray) or mask.dtype != np.bool_:
        kind = f"array of {mask.dtype}" if isinstance(mask, np.ndarray) else type(mask).__name__
        raise TypeError(f"options: reset_mask is no numpy array of bool but {kind}")
    if mask.shape != (num_envs,):
        raise ValueError(f"options: reset_mask has shape {mask.shape}, not {(num_envs,)}")
    if not mask.any():
        raise ValueError("options: reset_mask names no row")
    return mask.copy()


def row_seeds(seed: Any, num_envs: int) -> list[int | None]:
    """A seed or None for each row: counted on from an integer, or one each.

    Raises:
        Error: neither integers nor None, or below 0.
        ValueError: not as many as rows.
    """
    if seed is None:
        return [None] * num_envs
    if isinstance(seed, int):
        seeds: list[int | None] = [seed + row for row in range(num_envs)]
    elif isinstance(seed, Iterable) and not isinstance(seed, str | bytes | Mapping):
        seeds = list(seed)
    else:
        raise Error(f"seed: {seed!r} is neither an integer, nor one for each row, nor None")
    if len(seeds) != num_envs:
        raise ValueError(f"seed: {len(seeds)} seeds for {num_envs} environments")
    for one in seeds:
        seeding.np_random(one)  # raises what Gymnasium's other environments do
    return seeds
