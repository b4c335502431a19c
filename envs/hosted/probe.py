"""Whether an environment is fit to be trained on, by its spaces and one episode of it.

Knows nothing of JAX.
"""

from dataclasses import dataclass
from typing import Any

import gymnasium
import numpy as np

ENTRIES = ("observation", "achieved_goal", "desired_goal")


class TaskError(Exception):
    """An environment that cannot be trained on; the message is one line."""


@dataclass(frozen=True)
class Episode:
    """One of random actions; the first row of each array is what the reset shows.

    Attributes:
        shown: by entry, [T + 1, n] float32.
        said: `is_success` of each row, None where the environment does not say.
        terminated: whether the environment ended it, and did not cut it off.
        remarks: lines about what is allowed but hardly meant.
    """

    shown: dict[str, np.ndarray]
    said: list[bool | None]
    terminated: bool
    remarks: list[str]


def entry_sizes(env: Any) -> dict[str, int]:
    """How many numbers each entry of an observation has.

    Raises:
        TaskError: it is no goal environment, or its goals are not alike.
    """
    space = env.observation_space
    if not isinstance(space, gymnasium.spaces.Dict) or not set(ENTRIES) <= set(space.spaces):
        raise TaskError(f"{env.spec.id} is no goal environment: it lacks {', '.join(ENTRIES)}")
    sizes = {}
    for name in ENTRIES:
        entry = space.spaces[name]
        shape = entry.shape or ()
        if not isinstance(entry, gymnasium.spaces.Box) or len(shape) != 1 or not shape[0]:
            raise TaskError(f"{name} of {env.spec.id} is {entry}, not numbers [n]")
        sizes[name] = shape[0]
    achieved, desired = (space.spaces[name].shape for name in ENTRIES[1:])
    if achieved != desired:
        raise TaskError(
            f"achieved_goal of {env.spec.id} has shape {achieved} and desired_goal {desired}"
        )
    return sizes


def action_bounds(env: Any) -> tuple[np.ndarray, np.ndarray]:
    """Least and greatest action, [a].

    Raises:
        TaskError: actions are of another kind.
    """
    space = env.action_space
    bounded = isinstance(space, gymnasium.spaces.Box) and space.is_bounded()
    if not bounded or len(space.shape) != 1:
        raise TaskError(f"actions of {env.spec.id} are {space}, not bounded numbers [n]")
    if not np.issubdtype(space.dtype, np.floating):
        raise TaskError(f"actions of {env.spec.id} are {space.dtype}, not floating-point numbers")
    return space.low, space.high


def episode_length(env: Any) -> int:
    """How many steps an episode takes.

    Raises:
        TaskError: the environment does not say.
    """
    length = getattr(env.spec, "max_episode_steps", None)
    if not isinstance(length, int) or length < 1:
        raise TaskError(f"{env.spec.id} has no max_episode_steps, the length of its episodes")
    return length


def play(env: Any, length: int) -> Episode:
    """Play an episode of at most so many steps, and its beginning again.

    Raises:
        TaskError: what it shows is not what its space says, or its goal does not stay.
    """
    env.action_space.seed(0)
    shown = [_entries(env, env.reset(seed=0)[0])]
    actions, terminated, cut = [], False, False
    said: list[bool | None] = [None]
    while len(actions) < length:
        actions.append(env.action_space.sample())
        step, _, terminated, truncated, info = env.step(actions[-1].copy())  # it may write into it
        shown.append(_entries(env, step))
        said.append(bool(info["is_success"]) if "is_success" in info else None)
        if terminated or truncated:
            cut = not terminated and len(actions) < length
            break
    arrays = {name: np.stack([one[name] for one in shown]) for name in ENTRIES}
    goals = arrays["desired_goal"]
    if not np.array_equal(goals, np.broadcast_to(goals[0], goals.shape), equal_nan=True):
        raise TaskError(f"step of {env.spec.id} changes desired_goal, which holds for an episode")
    remarks = _remarks_on_values(env, arrays)
    if cut:
        remarks.append(
            f"{env.spec.id} itself cuts an episode off after {len(actions)} of its {length} steps; "
            "episodes with which it does that are dropped"
        )
    if not _repeats(env, shown[:2], actions[0]):
        remarks.append(
            f"reset and step of {env.spec.id} give other values for the same seed and action; "
            "what is trained with them cannot be repeated, nor resumed to the same bits"
        )
    return Episode(arrays, said, bool(terminated), remarks)


def _entries(env: Any, shown: dict[str, Any]) -> dict[str, np.ndarray]:
    """Copies, since an environment may show the same array again and again."""
    entries = {name: np.array(shown[name], np.float32) for name in ENTRIES}
    for name, values in entries.items():
        declared = env.observation_space.spaces[name].shape
        if values.shape != declared:
            raise TaskError(
                f"{name} of {env.spec.id} has shape {values.shape}, its space says {declared}"
            )
    return entries


def _remarks_on_values(env: Any, arrays: dict[str, np.ndarray]) -> list[str]:
    for name, values in arrays.items():
        if not np.isfinite(values).all():
            where = "step" if np.isfinite(values[0]).all() else "reset"
            return [
                f"{name} is not finite after {where} of {env.spec.id}; "
                "episodes in which that happens are dropped"
            ]
    return []


def _repeats(env: Any, first: list[dict[str, np.ndarray]], action: Any) -> bool:
    """Whether a reset with the same seed, and a step, give the same once more."""
    again = [_entries(env, env.reset(seed=0)[0]), _entries(env, env.step(action)[0])]
    return all(
        np.array_equal(before[name], after[name], equal_nan=True)
        for before, after in zip(first, again, strict=True)
        for name in ENTRIES
    )
