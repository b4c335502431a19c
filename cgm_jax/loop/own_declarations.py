"""What an environment of the user's own declares of itself, read and checked."""

import operator
from numbers import Real
from typing import Any

import numpy as np

from cgm_jax.config.fields import SettingError
from cgm_jax.config.user_code import user_code
from cgm_jax.envs import Stage
from cgm_jax.loop.own_states import in_one_line

MAX_ACTION_SIZE = 10_000
MAX_STAGE_SIZE = 10_000
MAX_EPISODE_LENGTH = 1_000_000
THRESHOLDS = (1e-15, 1e15)
"""Squares of distances must be numbers of float32."""


def whole_number(env: Any, name: str, attribute: str, most: int) -> int:
    """An attribute that counts something.

    Raises:
        SettingError: it is no whole number from 1 to `most`.
    """
    with user_code("env", f"{attribute} of {name}"):
        value = getattr(env, attribute)
        try:
            number = None if isinstance(value, bool | np.bool_) else operator.index(value)
        except TypeError:  # jax.Array says so, too, of what is no integer scalar
            number = None
        shown = in_one_line(value)
    if number is None:
        raise SettingError(f"env: {attribute} of {name} is {shown}, not a whole number")
    if not 1 <= number <= most:
        raise SettingError(f"env: {attribute} of {name} is {shown}, not within [1, {most:,}]")
    return number


def stages_of(env: Any, name: str) -> tuple[Stage, ...]:
    """The stages before the goal; none where the environment declares none.

    Raises:
        SettingError: what it declares are no stages.
    """
    with user_code("env", f"stages of {name}"):
        stages = tuple(getattr(env, "stages", ()))
    for stage in stages:
        if not isinstance(stage, Stage):
            kind = type(stage).__name__
            raise SettingError(f"env: stages of {name} hold {kind}, not an envs.Stage")
        whole_number(stage, f"a stage of {name}", "size", MAX_STAGE_SIZE)
        distance_threshold_of(stage, f"a stage of {name}")
    return stages


def distance_threshold_of(env: Any, name: str) -> float:
    """The distance within which a goal is achieved.

    Raises:
        SettingError: it is no number of which distances can be compared with.
    """
    with user_code("env", f"distance_threshold of {name}"):
        value = env.distance_threshold
        shown = in_one_line(value)
        is_array = np.ndim(value) == 0 and getattr(value, "dtype", None) is not None
        is_number = isinstance(value, Real) or (is_array and np.asarray(value).dtype.kind in "fiu")
        if not is_number or isinstance(value, bool | np.bool_):
            raise SettingError(f"env: distance_threshold of {name} is {shown}, not a number")
        number, (low, high) = float(value), THRESHOLDS
        if not low <= number <= high:  # NaN is not
            raise SettingError(
                f"env: distance_threshold of {name} is {shown}, not within [{low:g}, {high:g}]"
            )
        return number


def tolerance_of(env: Any, name: str) -> np.ndarray:
    """The tolerance per goal dimension [n], float32."""
    low, high = THRESHOLDS
    with user_code("env", f"goal_tolerance of {name}"):
        value, shown = np.asarray(env.goal_tolerance), in_one_line(env.goal_tolerance)
    if (
        value.ndim != 1
        or value.dtype.kind not in "fiu"
        or not ((low <= value) & (value <= high)).all()
    ):
        raise SettingError(
            f"env: goal_tolerance of {name} is {shown}, not one number per dimension, "
            f"each within [{low:g}, {high:g}]"
        )
    if hasattr(env, "goal_success"):
        raise SettingError(f"env: {name} has both goal_tolerance and goal_success")
    return value.astype(np.float32)


def reward_range_of(env: Any, name: str) -> tuple[float, float]:
    """Least and greatest of the environment's own rewards."""
    with user_code("env", f"reward_range of {name}"):
        value = getattr(env, "reward_range", None)
        numbers = np.asarray(value, float) if value is not None else np.zeros(0)
    fits = numbers.shape == (2,) and np.isfinite(numbers).all() and numbers[0] < numbers[1]
    if not fits:
        raise SettingError(
            f"env: {name} has goal_reward, so it needs reward_range, (least, greatest); "
            f"it is {in_one_line(value)}"
        )
    return float(numbers[0]), float(numbers[1])
