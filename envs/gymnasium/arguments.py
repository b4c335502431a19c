"""What the environments may be made with. What is of no use is refused by name.

A setting without effect is worse than an error, as `episode_length=10` that leaves episodes at
50 steps.
"""

import math
import numbers
import operator
from collections.abc import Mapping
from typing import Any

from gymnasium.vector import AutoresetMode

from cgm_jax.envs.rendering import FRAMES_PER_SECOND

METADATA: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": FRAMES_PER_SECOND}

FIELDS = ("air_probability", "distance_threshold")

INSTEAD = {
    "episode_length": "write max_episode_steps, as for any Gymnasium environment",
    "max_episode_steps": "it is for gymnasium.make, which wraps a TimeLimit around",
    "autoreset_mode": f"only {AutoresetMode.NEXT_STEP.value!r} here; for the others write "
    'gymnasium.make_vec(..., vectorization_mode="sync", vector_kwargs={"autoreset_mode": ...})',
}


def check_render_mode(mode: str | None) -> None:
    """Check a render mode.

    Raises:
        ValueError: it is neither None nor "rgb_array".
    """
    if mode not in (None, *METADATA["render_modes"]):
        raise ValueError(f"render_mode: {mode!r} is neither None nor 'rgb_array'")


def check_fields(fields: Mapping[str, Any]) -> None:
    """Check the arguments that are passed on to `envs.make`.

    Raises:
        TypeError: a value is no number.
        ValueError: no such argument, or a value is not finite.
    """
    for name, value in fields.items():
        if name not in FIELDS:
            advice = INSTEAD.get(name, f"choose from {', '.join(FIELDS)}")
            raise ValueError(f"{name}: no such field; {advice}")
        if not isinstance(value, numbers.Real) or isinstance(value, bool):
            raise TypeError(f"{name}: {value!r} is no number")
        if not math.isfinite(value):
            raise ValueError(f"{name}: {value} is not finite")


def row_count(num_envs: Any) -> int:
    """How many rows a vector environment has.

    Raises:
        TypeError: no integer.
        ValueError: less than 1.
    """
    refusal = TypeError(f"num_envs: {num_envs!r} is no integer")
    if isinstance(num_envs, bool):
        raise refusal
    try:
        count = operator.index(num_envs)
    except TypeError:
        raise refusal from None
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
    if not isinstance(max_episode_steps, int) or isinstance(max_episode_steps, bool):
        raise TypeError(f"max_episode_steps: {max_episode_steps!r} is no integer")
    if max_episode_steps == -1:
        return math.inf
    if max_episode_steps < 1:
        raise ValueError(f"max_episode_steps: {max_episode_steps} is neither above 0 nor -1")
    return max_episode_steps
