"""Rows of a Gymnasium goal environment, stepped through its vector API. Knows nothing of JAX.

An episode of k rows is a *batch*, with a ticket that every row of it carries. Where rows come whose
batch is not as far as they are, because a reset was drawn for its goals alone or the same start
serves several policies, it begins again from their seeds; that is possible before the first step.
So of as many rows as were never stepped a reset makes no batch: a curriculum may draw a thousand
goals, each of which would keep a simulator.
"""

import contextlib
import itertools
import warnings
from typing import Any

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv

# Relative, since the worker's interpreter may not have cgm_jax.
from .probe import ENTRIES, TaskError, action_bounds, entry_sizes, episode_length, play
from .rule import Rule

MAX_UNUSED = 4
"""Batches of one size that were reset but not stepped; older ones are given up."""


LOOKED_AT = 16
"""Rows of the vector environment that shows what so many seeds begin with."""

NO_TICKET = 0
"""Of rows that are in no batch."""


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
        self._batches: dict[int, Batch] = {}
        self._stepped: set[int] = set()  # numbers of rows
        self._idle: list[VectorEnv] = []
        self._tickets = itertools.count(1)
        self._env = _made(env_id)
        try:
            self.facts = self._look()
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """Close all environments, whatever they say to that."""
        for env in (self._env, *self._idle, *(batch.env for batch in self._batches.values())):
            with contextlib.suppress(Exception):
                env.close()

    def reset(self, seeds: np.ndarray) -> tuple[int, Batch]:
        """Begin an episode in each row, or look at what it would begin with; returns its ticket."""
        if len(seeds) in self._stepped:
            return self._begun(seeds)
        size = min(len(seeds), LOOKED_AT)
        pieces = [self._shown(seeds[i : i + size], size) for i in range(0, len(seeds), size)]
        looked_at = pieces[0]
        looked_at.seeds = seeds
        for name in ENTRIES:
            rows = np.concatenate([piece.observation[name] for piece in pieces])
            looked_at.observation[name] = rows[: len(seeds)]
        looked_at.terminated = looked_at.truncated = np.zeros(len(seeds), bool)
        return NO_TICKET, looked_at

    def _shown(self, seeds: np.ndarray, size: int) -> Batch:
        """What `size` rows begin with, of which the first have these seeds; in no batch of ours."""
        batch = self._batch(np.resize(seeds, size))
        self._idle.append(batch.env)
        return batch

    def _begun(self, seeds: np.ndarray) -> tuple[int, Batch]:
        """Begin an episode in each row; returns its ticket."""
        unused = [
            ticket
            for ticket, batch in self._batches.items()
            if not batch.steps and len(batch.seeds) == len(seeds)
        ]
        for ticket in unused[: -MAX_UNUSED + 1]:
            self._release(ticket)
        ticket, batch = next(self._tickets), self._batch(seeds)
        self._batches[ticket] = batch
        return ticket, batch

    def _batch(self, seeds: np.ndarray) -> Batch:
        """Rows that were just reset, of an environment that was idle or is made."""
        fitting = [env for env in self._idle if env.num_envs == len(seeds)]
        if fitting:
            self._idle.remove(fitting[0])
        env = fitting[0] if fitting else self._make(len(seeds))
        try:
            return Batch(env, seeds)
        except BaseException:
            self._idle.append(env)  # to be closed with the others
            raise

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
            self._stepped.add(len(seeds))
            ticket, batch = self._begun(seeds)
        elif batch is None or not fits or (tickets != ticket).any():
            raise TaskError(f"rows of {self._id} are from different episodes")
        else:
            alive = ~(batch.terminated | batch.truncated)
            if (steps[alive] != batch.steps).any():
                raise TaskError(f"rows of {self._id} cannot go back to a state that has passed")
        # So that bounds of +-1 leave an action as it is; others might be passed by a rounding.
        middle, half = (self._low + self._high) / 2.0, (self._high - self._low) / 2.0
        scaled = (middle + half * np.clip(actions, -1.0, 1.0)).astype(self._low.dtype)
        batch.step(np.clip(scaled, self._low, self._high), self._length)
        if batch.steps == self._length:
            self._release(ticket)
        return ticket, batch

    def success(self, achieved: np.ndarray, desired: np.ndarray) -> np.ndarray:
        """Whether goals [k, n] are achieved by the environment's own rule, [k] bool."""
        return self._rule.success(achieved, desired)

    def _look(self) -> dict[str, Any]:
        sizes = entry_sizes(self._env)
        self._low, self._high = action_bounds(self._env)
        self._length = episode_length(self._env)
        episode = play(self._env, self._length)
        self._rule = Rule(self._env, episode)
        remarks = [*episode.remarks]
        if not self._rule.agrees(episode):
            remarks.append(
                f"success is judged by {self._rule.name} of {self._id}, not by is_success"
            )
        achieved, desired = (episode.shown[f"{kind}_goal"][-1:] for kind in ("achieved", "desired"))
        steps = len(episode.said) - 1
        if (
            episode.terminated
            and steps < self._length
            and not self._rule.success(achieved, desired)[0]
        ):
            remarks.append(
                f"{self._id} ended an episode without success; where a step costs 1 and nothing "
                "comes after the end, to end early may be worth more than to go on"
            )
        return {
            "observation_size": sizes["observation"],
            "goal_size": sizes["desired_goal"],
            "action_size": self._low.size,
            "episode_length": self._length,
            "distance_threshold": self._rule.distance_threshold,
            "remarks": remarks,
        }

    def _release(self, ticket: int) -> None:
        self._idle.append(self._batches.pop(ticket).env)

    def _make(self, count: int) -> VectorEnv:
        """A vector environment of `count` rows that never resets one by itself unseen."""
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            env = gymnasium.make_vec(self._id, num_envs=count)
            if env.metadata.get("autoreset_mode") != AutoresetMode.NEXT_STEP:
                env.close()
                env = gymnasium.make_vec(self._id, num_envs=count, vectorization_mode="sync")
        return env


def _made(env_id: str) -> Any:
    """The environment.

    Raises:
        TaskError: Gymnasium does not know it.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return gymnasium.make(env_id)
    except gymnasium.error.Error as error:
        line = str(error).partition("\n")[0]
        raise TaskError(f"{line} (gymnasium:MODULE:ID imports a module first)") from None
