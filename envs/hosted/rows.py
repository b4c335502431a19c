"""Rows of a Gymnasium goal environment, stepped through its vector API. Knows nothing of JAX.

An episode of k rows is a *batch*, with a ticket that every row of it carries. Where rows come whose
batch is not as far as they are, because a reset was drawn for its goals alone or the same start
serves several policies, it begins again from their seeds; that is possible before the first step.
"""

import contextlib
import itertools
import numbers
import warnings
from typing import Any

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv

ENTRIES = ("observation", "achieved_goal", "desired_goal")
MAX_UNUSED = 4
"""Batches of one size that were reset but not stepped; older ones are given up."""


class TaskError(Exception):
    """An environment that cannot be trained on; the message is one line."""


class Batch:
    """Rows in the middle of an episode.

    Attributes:
        env: their environment.
        seeds: with which they were reset, [k].
        steps: taken so far.
        observation: what each row shows, by entry [k, ...]; of a row that has ended, its last.
        terminated: whether the environment has ended each row, [k].
        truncated: whether it was cut off before its last step, [k].
    """

    def __init__(self, env: VectorEnv, seeds: np.ndarray) -> None:
        """Reset all rows."""
        self.env, self.seeds, self.steps = env, seeds, 0
        each: Any = [int(seed) for seed in seeds]  # of vector environments the base types no list
        shown, _ = env.reset(seed=each)
        self.observation = {name: np.array(shown[name], np.float32) for name in ENTRIES}
        self.terminated = np.zeros(len(seeds), bool)
        self.truncated = np.zeros(len(seeds), bool)

    def step(self, actions: np.ndarray, length: int) -> None:
        """Advance the rows that have not ended."""
        self.steps += 1
        shown, _, terminated, truncated, _ = self.env.step(actions)
        alive = ~(self.terminated | self.truncated)
        for name in ENTRIES:
            self.observation[name][alive] = shown[name][alive]
        self.terminated |= alive & terminated
        if self.steps < length:
            self.truncated |= alive & truncated & ~terminated


class Rows:
    """A task's environments, and its rule of success.

    Attributes:
        facts: sizes, episode length, distance threshold and remarks, by name.
    """

    def __init__(self, env_id: str) -> None:
        """Look at the environment, and play an episode of it.

        Raises:
            TaskError: it cannot be trained on.
        """
        self._id = env_id
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                self._env: Any = gymnasium.make(env_id)
        except gymnasium.error.Error as error:
            line = str(error).partition("\n")[0]
            raise TaskError(f"{line} (gymnasium:MODULE:ID imports a module first)") from None
        self._batches: dict[int, Batch] = {}
        self._idle: list[VectorEnv] = []
        self._tickets = itertools.count(1)
        sizes = _sizes(self._env)
        self._low, self._high = _action_bounds(self._env)
        length = getattr(self._env.spec, "max_episode_steps", None)
        if not isinstance(length, int) or length < 1:
            raise TaskError(f"{env_id} has no max_episode_steps, the length of its episodes")
        self.remarks: list[str] = []
        goals, achieved, said = self._play(length)
        self._choose_rule(goals, achieved, said)
        self.facts = {
            "observation_size": sizes["observation"],
            "goal_size": sizes["desired_goal"],
            "action_size": self._low.size,
            "episode_length": length,
            "distance_threshold": self._threshold if self._threshold else self._measured(goals[0]),
            "remarks": self.remarks,
        }
        self._length = length

    def reset(self, seeds: np.ndarray) -> tuple[int, Batch]:
        """Begin an episode in each row; returns its ticket."""
        unused = [
            ticket
            for ticket, batch in self._batches.items()
            if not batch.steps and len(batch.seeds) == len(seeds)
        ]
        for ticket in unused[: -MAX_UNUSED + 1]:
            self._release(ticket)
        fitting = [env for env in self._idle if env.num_envs == len(seeds)]
        if fitting:
            self._idle.remove(fitting[0])
        ticket = next(self._tickets)
        batch = Batch(fitting[0] if fitting else self._make(len(seeds)), seeds)
        self._batches[ticket] = batch
        return ticket, batch

    def step(
        self, tickets: np.ndarray, steps: np.ndarray, seeds: np.ndarray, actions: np.ndarray
    ) -> tuple[int, Batch]:
        """One step of every row.

        Args:
            tickets: of the rows' batch, all alike, [k].
            steps: how many each row has taken; of one that has ended, not read, [k].
            seeds: with which they were reset, [k].
            actions: in [-1, 1], [k, a].

        Returns:
            The ticket, which is another one where the batch had to begin again, and the batch.

        Raises:
            TaskError: the rows are not of one batch, or not where it is.
        """
        ticket, step = int(tickets[0]), int(steps.max())
        batch = self._batches.get(ticket)
        fits = batch is not None and np.array_equal(batch.seeds, seeds)
        if step == 0 and not (fits and batch is not None and batch.steps == 0):
            ticket, batch = self.reset(seeds)
        elif batch is None or not fits or (tickets != ticket).any():
            raise TaskError(f"rows of {self._id} are from different episodes")
        else:
            alive = ~(batch.terminated | batch.truncated)
            if (steps[alive] != batch.steps).any():
                raise TaskError(f"rows of {self._id} cannot go back to a state that has passed")
        # So that bounds of +-1 leave an action as it is.
        middle, half = (self._low + self._high) / 2.0, (self._high - self._low) / 2.0
        scaled = middle + half * np.clip(actions, -1.0, 1.0)
        batch.step(scaled.astype(self._low.dtype), self._length)
        if batch.steps == self._length:
            self._release(ticket)
        return ticket, batch

    def success(self, achieved: np.ndarray, desired: np.ndarray) -> np.ndarray:
        """Whether goals [k, n] are achieved by the environment's own rule, [k] bool."""
        if self._rewarded is None:
            assert self._threshold is not None
            return np.linalg.norm(achieved - desired, axis=-1) < self._threshold
        return self._rewards(achieved, desired) == self._rewarded

    def _release(self, ticket: int) -> None:
        self._idle.append(self._batches.pop(ticket).env)

    def _make(self, count: int) -> VectorEnv:
        """A vector environment of `count` rows that never resets one by itself unseen."""
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            env = gymnasium.make_vec(self._id, num_envs=count)
            if env.metadata.get("autoreset_mode") == AutoresetMode.SAME_STEP:
                env.close()
                env = gymnasium.make_vec(self._id, num_envs=count, vectorization_mode="sync")
        return env

    def _play(self, length: int) -> tuple[np.ndarray, np.ndarray, list[bool | None]]:
        """Goals and achieved goals [T, n] of an episode of random actions, and `is_success`."""
        shown, _ = self._env.reset(seed=0)
        self._env.action_space.seed(0)
        goals, achieved, said = [], [], []
        for _ in range(length):
            shown, _, terminated, truncated, info = self._env.step(self._env.action_space.sample())
            goals.append(np.asarray(shown["desired_goal"], np.float32))
            achieved.append(np.asarray(shown["achieved_goal"], np.float32))
            said.append(bool(info["is_success"]) if "is_success" in info else None)
            if terminated or truncated:
                break
        return np.stack(goals), np.stack(achieved), said

    def _choose_rule(
        self, goals: np.ndarray, achieved: np.ndarray, said: list[bool | None]
    ) -> None:
        """Sparse `compute_reward`, or else the distance threshold; compared with `is_success`."""
        threshold = _found(self._env, "distance_threshold")
        is_number = isinstance(threshold, numbers.Real) and float(threshold) > 0.0
        self._threshold = float(threshold) if is_number else None
        self._rewarded: float | None = None
        self._compute = _found(self._env, "compute_reward")
        self._takes_many = True
        if callable(self._compute):
            self._takes_many = self._many_work(achieved, goals)
            rewarded = self._rewards(goals, goals)
            others = self._rewards(achieved, goals)
            if len(set(rewarded)) == 1 and len({*rewarded, *others}) <= 2:
                self._rewarded = float(rewarded[0])
        if self._rewarded is None and self._threshold is None:
            raise TaskError(
                f"{self._id} has neither a compute_reward of two values nor a distance_threshold"
            )
        judged = self.success(achieved, goals)
        if any(one is not None and one != mine for one, mine in zip(said, judged, strict=True)):
            rule = "distance_threshold" if self._rewarded is None else "compute_reward"
            self.remarks.append(f"success is judged by {rule} of {self._id}, not by is_success")

    def _many_work(self, achieved: np.ndarray, goals: np.ndarray) -> bool:
        """Whether `compute_reward` takes goals [k, n] at once, with the same results."""
        singly = [self._compute(a, d, {}) for a, d in zip(achieved, goals, strict=True)]
        with contextlib.suppress(Exception):
            together = np.asarray(self._compute(achieved, goals, {}))
            return together.shape == (len(goals),) and np.array_equal(together, singly)
        return False

    def _rewards(self, achieved: np.ndarray, desired: np.ndarray) -> np.ndarray:
        if self._takes_many:
            return np.asarray(self._compute(achieved, desired, {}))
        pairs = zip(achieved, desired, strict=True)
        return np.array([self._compute(one, other, {}) for one, other in pairs])

    def _measured(self, goal: np.ndarray) -> float:
        """How far one dimension may be off, at most, by the environment's own rule."""

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
            raise TaskError(f"{self._id} has no distance_threshold, and none is to be measured")
        return min(reaches)


def _found(env: Any, name: str) -> Any:
    """An attribute of an environment, of what it wraps, or of its task (as panda-gym has it)."""
    for owner in (env.unwrapped, getattr(env.unwrapped, "task", None)):
        if hasattr(owner, name):
            return getattr(owner, name)
    return None


def _sizes(env: Any) -> dict[str, int]:
    space = env.observation_space
    if not isinstance(space, gymnasium.spaces.Dict) or not set(ENTRIES) <= set(space.spaces):
        raise TaskError(f"{env.spec.id} is no goal environment: it lacks {', '.join(ENTRIES)}")
    sizes = {}
    for name in ENTRIES:
        entry = space.spaces[name]
        if not isinstance(entry, gymnasium.spaces.Box) or len(entry.shape) != 1:
            raise TaskError(f"{name} of {env.spec.id} is {entry}, not numbers [n]")
        sizes[name] = entry.shape[0]
    return sizes


def _action_bounds(env: Any) -> tuple[np.ndarray, np.ndarray]:
    space = env.action_space
    bounded = isinstance(space, gymnasium.spaces.Box) and space.is_bounded()
    if not bounded or len(space.shape) != 1:
        raise TaskError(f"actions of {env.spec.id} are {space}, not bounded numbers [n]")
    return space.low, space.high
