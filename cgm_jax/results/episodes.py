"""Whole episodes of policies, in calls of bounded size: how many succeeded, and what happened."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from cgm_jax.envs import GoalEnvironment
from cgm_jax.loop.environment import compiler_options, is_hosted
from cgm_jax.loop.exploration import Exploration
from cgm_jax.loop.judging import succeeds
from cgm_jax.loop.own_environment import OwnEnvironment
from cgm_jax.loop.own_states import is_key
from cgm_jax.loop.rollout import Policy, Rollout, drawn_goals, roll_out
from cgm_jax.machine.device_errors import device_errors
from cgm_jax.replay.ring import Episodes
from cgm_jax.results.plan import Plan, goal_mask

if TYPE_CHECKING:
    from brax.envs.base import State

Progress = Callable[[int, int], None]
"""Is told how many episodes of how many are done, over all policies."""

Result = tuple[jax.Array, jax.Array, "Recording | None"]
"""Successes, valid episodes, and the recording."""

CHUNK_EPISODES = 256
"""Episodes that a policy plays in one call of the device, at most: seconds, so that progress shows
and memory is bounded.
"""

HOSTED_EPISODES = 16
"""The same of a hosted environment, where each needs a simulator of its own."""

CHUNK_ROWS = 4096
"""Episodes over all policies in one such call; those of hosted environments are of one policy."""


class Recording(struct.PyTreeNode):
    """Whole episodes, K of them.

    Attributes:
        states: of a Fetch environment those of the physics, of one of the user's own its own,
            leading axes [T + 1, K].
        desired_goal: [K, n].
        achieved: whether the masked goal is, at every step, [K, T + 1] bool.
        valid: whether the physics held, [K] bool.
    """

    states: Any
    desired_goal: jax.Array
    achieved: jax.Array
    valid: jax.Array


@dataclass(frozen=True)
class Outcome:
    """What became of one policy's episodes.

    Attributes:
        env: the environment that they ran in.
        episodes: how many there were.
        valid: how many of them the physics held in; the others are dropped.
        successes: how many valid ones achieved the (masked) goal at their last step.
        recording: the recorded episodes, None where none were asked for.
    """

    env: GoalEnvironment
    episodes: int
    valid: int
    successes: int
    recording: Recording | None

    @property
    def success_rate(self) -> float:
        """Share of successes; 0 where no episode was valid."""
        return self.successes / max(1, self.valid)


class Chunk(struct.PyTreeNode):
    """Episodes that are played in one call of the device.

    Attributes:
        keys: of their starts and goals, [E].
        counted: which of them count; the others only fill the last chunk up, [E] bool.
    """

    keys: jax.Array
    counted: jax.Array


def play_all(
    env: GoalEnvironment,
    play: Callable[[Any, Chunk, int], Result],
    policies: Any,
    count: int,
    plan: Plan,
    progress: Progress,
) -> list[Outcome]:
    """All episodes of all policies, in calls of bounded size, all of one shape.

    Args:
        env: what they play in.
        play: one policy's chunk of episodes, of which so many are recorded.
        policies: what `play` takes, every leaf with a leading axis of policies.
        count: how many policies there are.
        plan: the episodes.
        progress: is told of every chunk of episodes.

    Raises:
        DeviceError: the physics, the memory or something else below has failed.
    """

    def play_side_by_side(policies: Any, chunk: Chunk, recorded: int) -> Result:
        return jax.vmap(lambda policy: play(policy, chunk, recorded))(policies)

    options = compiler_options(env)
    program = jax.jit(play_side_by_side, static_argnums=2, compiler_options=options)
    # Each episode of a hosted environment takes a simulator of its own.
    size = min(plan.episodes, HOSTED_EPISODES if is_hosted(env) else CHUNK_EPISODES)
    width = 1 if is_hosted(env) else min(count, max(1, CHUNK_ROWS // size))
    outcomes: list[Outcome] = []
    for first in range(0, count, width):
        here = min(width, count - first)
        rows = np.minimum(np.arange(first, first + width), count - 1)
        block = jax.tree.map(lambda leaf, rows=rows: leaf[rows], policies)
        successes, valid, recordings = np.zeros(width, int), np.zeros(width, int), []
        for start, chunk in _chunks(plan, size):
            recorded = min(max(0, plan.recorded - start), size)
            with device_errors():
                result: Result = jax.tree.map(_on_host, program(block, chunk, recorded))
            successful, held, recording = result
            successes += successful
            valid += held
            recordings += [] if recording is None else [recording]
            played = min(start + size, plan.episodes)
            progress(first * plan.episodes + here * played, count * plan.episodes)
        for i in range(here):
            own = _join([jax.tree.map(lambda leaf, i=i: leaf[i], part) for part in recordings])
            outcomes.append(Outcome(env, plan.episodes, int(valid[i]), int(successes[i]), own))
    return outcomes


def _chunks(plan: Plan, size: int) -> Iterator[tuple[int, Chunk]]:
    """The plan's episodes, `size` at a time, and the number of the first one.

    An episode's key depends on its number alone.
    """
    keys = jax.random.split(jax.random.key(plan.seed), plan.episodes)
    for start in range(0, plan.episodes, size):
        numbers = np.arange(start, start + size)
        yield (
            start,
            Chunk(
                keys=keys[np.minimum(numbers, plan.episodes - 1)],
                counted=jnp.asarray(numbers < plan.episodes),
            ),
        )


def play_chunk(
    env: GoalEnvironment,
    policy: Policy,
    plan: Plan,
    chunk: Chunk,
    recorded: int,
    exploration: Exploration | None = None,
) -> Result:
    """Successes, valid episodes, and the recording of one policy's chunk of episodes."""
    first = jax.vmap(env.reset)(chunk.keys)
    goals = drawn_goals(env, first)
    kept = jnp.asarray(goal_mask(plan.mask, goals.mask.shape[-1]))
    goals = goals.replace(mask=jnp.broadcast_to(kept, goals.mask.shape))

    def keep(state: "State") -> Any:
        if not recorded:
            return None
        is_own = isinstance(env, OwnEnvironment)
        kept = state.state if is_own else state.pipeline_state  # pyright: ignore
        return _first(recorded, kept)

    rollout = roll_out(env, policy, first, goals, exploration, keep=keep)
    valid = rollout.outcomes.valid & chunk.counted
    recording = _recording(env, rollout, recorded) if recorded else None
    return jnp.sum(valid & rollout.outcomes.success), jnp.sum(valid), recording


def _join(parts: list[Recording]) -> Recording | None:
    """Recordings joined in order into one; None of none."""
    if not parts:
        return None
    return Recording(
        states=jax.tree.map(_joined, *(part.states for part in parts)),
        desired_goal=jnp.concatenate([part.desired_goal for part in parts]),
        achieved=jnp.concatenate([part.achieved for part in parts]),
        valid=jnp.concatenate([part.valid for part in parts]),
    )


def _on_host(leaf: jax.Array) -> np.ndarray | jax.Array:
    """An array of numpy's; of keys, which numpy does not know, as it is."""
    return leaf if is_key(leaf) else np.asarray(leaf)


def _joined(*rows: Any) -> Any:
    """Steps of episodes, [T + 1, E, ...] each, beside each other."""
    return (jnp if is_key(*rows) else np).concatenate(rows, 1)


def _recording(env: GoalEnvironment, rollout: Rollout, count: int) -> Recording:
    shown: Episodes = _first(count, rollout.episodes)
    achieved = shown.achieved_goal
    goal, mask = (
        jnp.broadcast_to(rows[:, None], achieved.shape) for rows in (shown.desired_goal, shown.mask)
    )
    return Recording(
        states=rollout.record,
        desired_goal=shown.desired_goal,
        achieved=succeeds(env, goal, mask, achieved, shown.threshold[:, None]),
        valid=rollout.outcomes.valid[:count],
    )


def _first(count: int, tree: Any) -> Any:
    return jax.tree.map(lambda leaf: leaf[:count], tree)
