"""When a goal counts as achieved, by a Gymnasium environment's own rule. Knows nothing of JAX."""

import contextlib
import math
import numbers
from typing import Any

import numpy as np

from .probe import Episode, TaskError

OFFSETS = [sign * 10.0**power for power in range(-4, 5) for sign in (1, -1)]
"""So far off, goals are judged to tell a reward of two values from a dense one."""


class Rule:
    """`compute_reward` where it has two values, or else `distance_threshold`.

    Attributes:
        name: which of the two.
        distance_threshold: the environment's, or how far one dimension may be off, at most.
    """

    def __init__(self, env: Any, episode: Episode) -> None:
        """Choose between the two, by the goals of an episode.

        Raises:
            TaskError: there is neither, or float32 cannot tell goals apart by it.
        """
        env_id = env.spec.id
        goals, achieved = episode.shown["desired_goal"], episode.shown["achieved_goal"]
        threshold = _found(env, "distance_threshold")
        is_number = isinstance(threshold, numbers.Real) and not isinstance(threshold, bool)
        is_distance = is_number and 0.0 < float(threshold) < math.inf
        self._threshold = float(threshold) if is_distance else None
        self._rewarded: float | None = None
        self._compute = _found(env, "compute_reward")
        self._takes_many = True
        failure = self._look_at_reward(achieved, goals) if callable(self._compute) else ""
        if self._rewarded is None and self._threshold is None:
            raise TaskError(
                f"{env_id} has neither a compute_reward of two values nor a distance_threshold"
                f"{failure}"
            )
        self.name = "distance_threshold" if self._rewarded is None else "compute_reward"
        self.distance_threshold = self._threshold or self._measured(env_id, goals[0])
        largest = np.abs(goals[0]).max()
        if np.spacing(largest) > self.distance_threshold:
            raise TaskError(
                f"distance_threshold of {env_id}, {self.distance_threshold:g}, is less than "
                f"float32 can tell apart at a desired_goal of {largest:g}"
            )

    def success(self, achieved: np.ndarray, desired: np.ndarray) -> np.ndarray:
        """Whether goals [k, n] are achieved, [k] bool."""
        if self._rewarded is None:
            assert self._threshold is not None
            return np.linalg.norm(achieved - desired, axis=-1) < self._threshold
        return self._rewards(achieved, desired) == self._rewarded

    def agrees(self, episode: Episode) -> bool:
        """Whether it says of an episode what `is_success` said, where that was said."""
        judged = self.success(episode.shown["achieved_goal"], episode.shown["desired_goal"])
        return all(one in (None, mine) for one, mine in zip(episode.said, judged, strict=True))

    def _look_at_reward(self, achieved: np.ndarray, goals: np.ndarray) -> str:
        """Find out whether `compute_reward` can be the rule; returns what it fails with, if so.

        It may not be written at all, or read what `info` holds after a step.
        """
        try:
            self._takes_many = self._many_work(achieved, goals)
            self._rewarded = self._reward_of_success(achieved, goals)
        except Exception as error:
            line = str(error).partition("\n")[0]
            return f"; compute_reward fails with {type(error).__name__}: {line}"
        return ""

    def _reward_of_success(self, achieved: np.ndarray, goals: np.ndarray) -> float | None:
        """What achieved goals are rewarded with, if the reward has that and one other value.

        An episode alone does not tell: a block that is never touched stays at one distance.
        """
        at_goals = set(self._rewards(goals, goals))
        rewards = at_goals | set(self._rewards(achieved, goals))
        size = goals.shape[1]
        for offset in OFFSETS:
            moved = goals[0] + np.float32(offset) * np.vstack([np.eye(size), np.ones(size)])
            desired = np.broadcast_to(goals[0], moved.shape)
            with contextlib.suppress(Exception):  # it may refuse goals that are out of its world
                rewards |= set(self._rewards(moved.astype(np.float32), desired))
        return float(at_goals.pop()) if len(at_goals) == 1 and len(rewards) == 2 else None

    def _many_work(self, achieved: np.ndarray, goals: np.ndarray) -> bool:
        """Whether `compute_reward` takes goals [k, n] at once, with the same results."""
        singly = [self._reward(a, d) for a, d in zip(achieved, goals, strict=True)]
        with contextlib.suppress(Exception):
            together = np.asarray(self._reward(achieved, goals))
            return together.shape == (len(goals),) and np.array_equal(together, singly)
        return False

    def _rewards(self, achieved: np.ndarray, desired: np.ndarray) -> np.ndarray:
        if self._takes_many:
            return np.asarray(self._reward(achieved, desired))
        pairs = zip(achieved, desired, strict=True)
        return np.array([self._reward(one, other) for one, other in pairs])

    def _reward(self, achieved: np.ndarray, desired: np.ndarray) -> Any:
        """The environment's own, which may write into what it is given."""
        return self._compute(achieved.copy(), desired.copy(), {})

    def _measured(self, env_id: str, goal: np.ndarray) -> float:
        """How far one dimension may be off, at most."""

        def holds(offset: float, axis: int) -> bool:
            moved = goal.copy()
            moved[axis] += offset
            return bool(self.success(moved[None], goal[None])[0])

        reaches = []
        for axis in range(goal.size):
            low, high = 0.0, 1e-4
            while holds(high, axis) and high < 1e4:
                low, high = high, 2.0 * high
            for _ in range(30):
                middle = (low + high) / 2.0
                low, high = (middle, high) if holds(middle, axis) else (low, middle)
            reaches.append(low)
        if not 0.0 < min(reaches) < 1e4:
            raise TaskError(f"{env_id} has no distance_threshold, and none is to be measured")
        return min(reaches)


def _found(env: Any, name: str) -> Any:
    """An attribute of an environment, of what it wraps, or of its task (as panda-gym has it)."""
    for owner in (env.unwrapped, getattr(env.unwrapped, "task", None)):
        if hasattr(owner, name):
            return getattr(owner, name)
    return None
