"""Goals of Gymnasium environments: their spaces, masks, and when one is achieved."""

from collections.abc import Mapping
from dataclasses import dataclass
from numbers import Real
from typing import Any, Literal, get_args

import numpy as np
from gymnasium import spaces
from numpy.typing import ArrayLike

from cgm_jax.envs.numpy_goals import difference, is_achieved, sparse_reward
from cgm_jax.gymnasium.mask_sampler import MAX_GOAL_SIZE

Observation = dict[str, Any]
Distance = Literal["euclidean", "per_dimension"]


@dataclass(frozen=True)
class AchievementRule:
    """When a goal counts as achieved.

    Attributes:
        threshold: achieved closer than this, in the unit of the goal; a scalar, or [n].
        distance: "euclidean": the length of the difference is below the (scalar) threshold, as in
            the paper. "per_dimension": the difference is below the threshold in every dimension.

    Raises:
        ValueError: an attribute out of its range.
    """

    threshold: np.ndarray
    distance: Distance

    def __post_init__(self) -> None:
        if self.distance not in get_args(Distance):
            raise ValueError(f"distance: {self.distance!r} is none of {get_args(Distance)}")
        if not (np.isfinite(self.threshold).all() and (self.threshold > 0).all()):
            raise ValueError(f"distance_threshold: {self.threshold} is not finite and above 0")
        if self.distance == "euclidean" and self.threshold.ndim:
            raise ValueError('distance_threshold: one per dimension needs distance="per_dimension"')

    def is_achieved(self, achieved_goal: np.ndarray, goal: np.ndarray) -> np.ndarray | np.bool:
        """Whether goals [..., n] are achieved, [...] bool.

        A masked dimension of a masked goal is the achieved goal's own, so it counts as achieved.
        """
        if self.distance == "per_dimension":
            return self.subgoals_achieved(achieved_goal, goal).all(axis=-1)
        return is_achieved(achieved_goal, goal, self.threshold)

    def subgoals_achieved(self, achieved_goal: np.ndarray, goal: np.ndarray) -> np.ndarray:
        """Whether each dimension of goals [..., n] is achieved, [..., n] bool."""
        return np.abs(difference(achieved_goal, goal)) < self.threshold

    def reward(self, achieved_goal: np.ndarray, goal: np.ndarray) -> Any:
        """0 where goals [..., n] are achieved, -1 elsewhere; [...] float64."""
        return sparse_reward(self.is_achieved(achieved_goal, goal))


def make_rule(
    goal_size: int, distance_threshold: ArrayLike | None, distance: Distance
) -> AchievementRule:
    """The rule for goals of n dimensions.

    Raises:
        ValueError: no threshold, or one of another shape than () and (n,); or as `AchievementRule`.
    """
    if distance_threshold is None:
        raise ValueError(
            "distance_threshold: the environment has no attribute of this name, so give one"
        )
    threshold = np.asarray(distance_threshold)
    entries = threshold.ravel().tolist()
    if not all(isinstance(entry, Real) and not isinstance(entry, bool) for entry in entries):
        raise ValueError(f"distance_threshold: {distance_threshold!r} holds no real numbers")
    if threshold.shape not in ((), (goal_size,)):
        raise ValueError(
            f"distance_threshold: shape {threshold.shape} is neither () nor ({goal_size},)"
        )
    return AchievementRule(threshold.astype(np.float64), distance)


def apply_mask(observation: Observation, mask: np.ndarray) -> Observation:
    """The observation with its goal masked: equation 1 of the paper.

    Args:
        observation: of one environment, or of a batch; not changed.
        mask: [..., n] bool, True where the goal counts.

    Returns:
        The same, with the achieved goal in the masked dimensions of `desired_goal`.
    """
    masked = np.where(mask, observation["desired_goal"], observation["achieved_goal"])
    return {**observation, "desired_goal": masked}


def goal_space(space: spaces.Space[Any]) -> spaces.Box:
    """The space of masked goals [n] under an observation space.

    It spans both kinds of goal, and holds both exactly, since a masked dimension is what was
    achieved.

    Raises:
        ValueError: not the observation space of a goal environment, or a goal of more than 512
            dimensions.
    """
    if not isinstance(space, spaces.Dict):
        raise ValueError(f"observation_space: {space} is not a Dict with the goals")
    missing = {"observation", "achieved_goal", "desired_goal"} - set(space.spaces)
    if missing:
        raise ValueError(f"observation_space: lacks {', '.join(sorted(missing))}")
    achieved = _goal_box(space.spaces, "achieved_goal")
    desired = _goal_box(space.spaces, "desired_goal")
    if achieved.shape != desired.shape:
        raise ValueError(
            f"observation_space: achieved_goal has shape {achieved.shape}, "
            f"desired_goal {desired.shape}"
        )
    return _spanned(achieved, desired)


def batched_goal_space(space: spaces.Dict) -> spaces.Box:
    """The space of masked goals [E, n] under that of a batch of environments.

    Rows may have bounds of their own; the goals of one row are a `goal_space`.
    """
    achieved, desired = (space.spaces[f"{kind}_goal"] for kind in ("achieved", "desired"))
    return _spanned(achieved, desired)  # pyright: ignore[reportArgumentType]


def _spanned(achieved: spaces.Box, desired: spaces.Box) -> spaces.Box:
    """The space of what lies between the bounds of either."""
    dtype = np.result_type(achieved.dtype, desired.dtype)
    return spaces.Box(
        np.minimum(achieved.low, desired.low).astype(dtype),
        np.maximum(achieved.high, desired.high).astype(dtype),
        dtype=dtype.type,
    )


def with_goal_space(space: spaces.Dict, goals: spaces.Space[Any]) -> spaces.Dict:
    """The observation space with another space of desired goals."""
    return spaces.Dict({**space.spaces, "desired_goal": goals})


def check_masks(masks: ArrayLike, shape: tuple[int, ...]) -> np.ndarray:
    """The masks as bool, broadcast to `shape`, which ends with the goal's size.

    Raises:
        ValueError: another shape, or something else than 0 and 1.
    """
    array = np.asarray(masks)
    if array.shape not in (shape, shape[-1:]):
        raise ValueError(f"mask: shape {array.shape} is not {shape}")
    if not np.isin(array, (0, 1)).all():
        raise ValueError("mask: holds something else than 0 and 1")
    return np.broadcast_to(array.astype(bool), shape)


def _goal_box(entries: Mapping[str, spaces.Space[Any]], name: str) -> spaces.Box:
    space = entries[name]
    if not isinstance(space, spaces.Box) or len(space.shape) != 1:
        raise ValueError(f"observation_space: {name} is {space}, not a Box of one axis")
    if not 1 <= space.shape[0] <= MAX_GOAL_SIZE:
        raise ValueError(
            f"observation_space: {name} has {space.shape[0]} dimensions, which is not within "
            f"[1, {MAX_GOAL_SIZE}]"
        )
    return space
