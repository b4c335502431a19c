"""What callers may pass to the environments. What is of no use is refused by name.

A setting without effect is worse than an error: `episode_length=10` that leaves episodes at 50
steps, an action of three entries that also drives the fingers.
"""

import math
import numbers
import operator
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from gymnasium.error import Error
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode

from envs.rendering import FRAMES_PER_SECOND

METADATA: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": FRAMES_PER_SECOND}

FIELDS = ("air_probability", "distance_threshold")

INSTEAD = {
    "episode_length": "write max_episode_steps, as for any Gymnasium environment",
    "max_episode_steps": "it is for gymnasium.make, which wraps a TimeLimit around",
    "autoreset_mode": f"only {AutoresetMode.NEXT_STEP.value!r} here; for the others write "
    'gymnasium.make_vec(..., vectorization_mode="sync", vector_kwargs={"autoreset_mode": ...})',
    "reset_mask": "a single environment has no rows",
}


def check_render_mode(mode: str | None) -> None:
    """Check a render mode.

    Raises:
        ValueError: it is neither None nor "rgb_array".
    """
    if mode not in (None, *METADATA["render_modes"]):
        raise ValueError(f"render_mode: {mode!r} is neither None nor 'rgb_array'")


def check_fields(fields: Mapping[str, Any]) -> None:
    """Check the arguments that go on to `envs.make`.

    Raises:
        TypeError: a value is no number.
        ValueError: no such argument, or a value is not finite.
    """
    for name, value in fields.items():
        if name not in FIELDS:
            advice = INSTEAD.get(name, f"choose from {', '.join(FIELDS)}")
            raise ValueError(f"{name}: no such field; {advice}")
        if not isinstance(value, numbers.Real):
            raise TypeError(f"{name}: {value!r} is no number")
        if not math.isfinite(value):
            raise ValueError(f"{name}: {value} is not finite")


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
        advice = "" if known else INSTEAD.get(unknown[0], "")
        raise ValueError(f"options: {unknown[0]!r} has no effect here{advice and f': {advice}'}")


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


def checked_action(
    action: Any, shape: tuple[int, ...], rows: np.ndarray | slice = slice(None)
) -> np.ndarray:
    """The action as float32, clipped to [-1, 1] as Gymnasium-Robotics does.

    Args:
        action: an array or nested sequence of numbers.
        shape: that it must have.
        rows: those whose numbers matter and must be finite.

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
    if not np.isfinite(array[rows]).all():
        raise ValueError(f"action: {array.tolist()} is not finite")
    return np.clip(array, -1.0, 1.0).astype(np.float32)


def row_count(num_envs: Any) -> int:
    """How many rows a vector environment has.

    Raises:
        TypeError: no integer.
        ValueError: less than 1.
    """
    try:
        count = operator.index(num_envs)
    except TypeError:
        raise TypeError(f"num_envs: {num_envs!r} is no integer") from None
    if count < 1:
        raise ValueError(f"num_envs: {count} is not at least 1")
    return count


def step_limit(max_episode_steps: int | None, default: int) -> float:
    """Steps per episode by the rules of `gymnasium.make`: None is the default, -1 no limit.

    Raises:
        TypeError: neither an integer nor None.
        ValueError: 0, or below -1.
    """
    if max_episode_steps is None:
        return default
    if not isinstance(max_episode_steps, int):
        raise TypeError(f"max_episode_steps: {max_episode_steps!r} is no integer")
    if max_episode_steps == -1:
        return math.inf
    if max_episode_steps < 1:
        raise ValueError(f"max_episode_steps: {max_episode_steps} is neither above 0 nor -1")
    return max_episode_steps


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
