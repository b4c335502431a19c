"""Success of exported policies, or of random actions, and the episodes behind it."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from cgm_jax.config.fields import SettingError
from cgm_jax.config.settings import Hyperparameters, Settings
from cgm_jax.envs import GoalEnvironment
from cgm_jax.envs.fetch import FetchEnvironment
from cgm_jax.envs.rendering import RenderingError, check_rendering
from cgm_jax.envs.viewer import check_display
from cgm_jax.loop.environment import compiler_options, is_hosted, make_environment
from cgm_jax.loop.exploration import Exploration, draw_exploration
from cgm_jax.loop.judging import succeeds
from cgm_jax.loop.own_environment import OwnEnvironment
from cgm_jax.loop.rollout import Policy, Rollout, drawn_goals, roll_out
from cgm_jax.machine.device_errors import device_errors
from cgm_jax.replay.ring import Episodes
from cgm_jax.results.chosen import Policies
from cgm_jax.results.plan import Plan, mask_words, masked_axes
from cgm_jax.storage.policies import act, load_policy

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

CHUNK_ROWS = 4096
"""Episodes over all policies in one such call; those of hosted environments, each of which needs a
simulator of its own, are of one policy.
"""

MAX_GIF_BYTES = 4 * 2**30
"""What the frames of a .gif may take: some 69 episodes of a Fetch task, 640 pixels wide."""

NOISE = 2**31
"""What makes the key of an episode's noise of its own; a reset splits that in far fewer."""


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


def evaluate_policies(
    policies: Sequence[Policies], plan: Plan, progress: Progress = lambda done, total: None
) -> dict[str, Outcome]:
    """Outcome of every policy, by name.

    Args:
        policies: the files, each name once.
        plan: the episodes.
        progress: is told of every chunk of episodes.

    Raises:
        SettingError: a policy is malformed or made for something else, or the plan does not fit
            the environment.
        DeviceError: the physics, the memory or something else below has failed.
    """
    # All environments first, so that what does not fit is refused before anything compiles.
    pairs = [(planned_environment(each.settings, plan), each.files) for each in policies]
    total, results = plan.episodes * sum(len(files) for _, files in pairs), {}
    for env, files in pairs:
        before = plan.episodes * len(results)
        results |= _evaluate_files(
            env, files, plan, lambda done, _, before=before: progress(before + done, total)
        )
    return results


def evaluate_random(
    settings: Settings, plan: Plan, progress: Progress = lambda done, total: None
) -> Outcome:
    """Outcome of uniformly random actions in the environment that `settings` names.

    Raises:
        SettingError: no such environment, or the plan does not fit it.
        DeviceError: as `evaluate_policies`.
    """
    env = planned_environment(settings, plan)

    def play(_: Any, chunk: Chunk, recorded: int) -> Result:
        def draw(key: jax.Array) -> Exploration:
            shape = (env.episode_length, env.action_size)
            return draw_exploration(jax.random.fold_in(key, NOISE), shape, Hyperparameters())

        noise = jax.vmap(draw, out_axes=1)(chunk.keys)
        return _play(env, _random_policy, plan, chunk, recorded, noise)

    (outcome,) = _play_all(env, play, {"none": np.zeros((1, 0))}, 1, plan, progress)
    return outcome


def _random_policy(observation: jax.Array, goal: jax.Array, noise: Exploration | None) -> jax.Array:
    del observation, goal
    if noise is None:
        raise ValueError("random actions need noise")
    return noise.random_action


def planned_environment(settings: Settings, plan: Plan) -> GoalEnvironment:
    """Make the environment that `settings` names, if the plan fits it.

    Raises:
        SettingError: it does not: a mask with more dimensions than the goal, a video of what
            cannot be rendered, or here.
    """
    if plan.engine is not None:
        settings = replace(settings, engine=plan.engine)
    env = make_environment(settings)
    if plan.recorded:
        _check_shown(env, settings.env, plan)
    size = _goal_size(env)
    for word, axis in zip(mask_words(plan.mask), masked_axes(plan.mask), strict=True):
        if axis >= size:
            raise SettingError(
                f"mask: goals of {settings.env} have no {word}, but dimensions 0 to {size - 1}"
            )
    return env


def _check_shown(env: GoalEnvironment, name: str, plan: Plan) -> None:
    """Check that episodes can be shown: now, and not after the evaluation."""
    shown_as = "view" if plan.view else "video"
    if plan.view and not isinstance(env, FetchEnvironment):
        raise SettingError(f"view: only the Fetch tasks have a scene of MuJoCo's, not {name}")
    if not isinstance(env, FetchEnvironment) and not hasattr(env, "render_frame"):
        raise SettingError(
            f"video: {name} has no render_frame(state, width, height); "
            "see envs.RenderableEnvironment"
        )
    if plan.gif_width is not None:
        _check_memory_of_gif(plan.recorded, env.episode_length, plan.gif_width)
    try:
        if plan.view:
            check_display()
        elif isinstance(env, FetchEnvironment):
            check_rendering()
    except RenderingError as error:
        raise SettingError(f"{shown_as}: {error}") from None


def _check_memory_of_gif(episodes: int, length: int, width: int) -> None:
    """Check that frames of a .gif fit: they share a palette, so that all are held till the end."""
    frame = width * (width * 3 // 4) * 4  # bytes; RGB, and then a number in the palette as well
    needed = episodes * length * frame
    if needed > MAX_GIF_BYTES:
        raise SettingError(
            f"video_episodes: a .gif of {episodes} takes {needed / 2**30:.1f} GiB of memory, and "
            f"{MAX_GIF_BYTES / 2**30:.0f} is the most; take fewer, a smaller width, or an .mp4"
        )


def goal_mask(mask: str, goal_size: int) -> np.ndarray:
    """From names of masked dimensions to 1 = keep, 0 = masked, [goal_size] float32."""
    kept = np.ones(goal_size, np.float32)
    kept[masked_axes(mask)] = 0.0
    return kept


def _evaluate_files(
    env: GoalEnvironment, files: Mapping[str, Path], plan: Plan, progress: Progress
) -> dict[str, Outcome]:
    sizes, paths = _sizes(env), list(files.values())
    try:
        policies = [load_policy(path, *sizes) for path in paths]
    except ValueError as error:
        raise SettingError(str(error)) from None
    shapes = [{name: array.shape for name, array in policy.items()} for policy in policies]
    for path, shape in zip(paths, shapes, strict=True):
        if shape != shapes[0]:
            raise SettingError(f"{path}: its layers are others than those of {paths[0]}")
    stacked = jax.tree.map(lambda *leaves: np.stack(leaves), *policies)

    def play(arrays: dict[str, jax.Array], chunk: Chunk, recorded: int) -> Result:
        def policy(observation: jax.Array, goal: jax.Array, _: Exploration | None) -> jax.Array:
            return act(arrays, observation, goal, goal_mask(plan.mask, _goal_size(env)))

        return _play(env, policy, plan, chunk, recorded)

    outcomes = _play_all(env, play, stacked, len(files), plan, progress)
    return dict(zip(files, outcomes, strict=True))


class Chunk(struct.PyTreeNode):
    """Episodes that are played in one call of the device.

    Attributes:
        keys: of their starts and goals, [E].
        counted: which of them count; the others only fill the last chunk up, [E] bool.
    """

    keys: jax.Array
    counted: jax.Array


def _play_all(
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
    size = min(plan.episodes, CHUNK_EPISODES)
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
                result: Result = jax.tree.map(np.asarray, program(block, chunk, recorded))
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


def _play(
    env: GoalEnvironment,
    policy: Policy,
    plan: Plan,
    chunk: Chunk,
    recorded: int,
    exploration: Exploration | None = None,
) -> Result:
    """Successes, valid episodes, and the recording of one policy's chunk of episodes."""
    mask = jnp.asarray(goal_mask(plan.mask, _goal_size(env)))
    first = jax.vmap(env.reset)(chunk.keys)
    goals = drawn_goals(env, first)
    goals = goals.replace(mask=jnp.broadcast_to(mask, goals.mask.shape))

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
        states=jax.tree.map(lambda *rows: np.concatenate(rows, 1), *(p.states for p in parts)),
        desired_goal=jnp.concatenate([part.desired_goal for part in parts]),
        achieved=jnp.concatenate([part.achieved for part in parts]),
        valid=jnp.concatenate([part.valid for part in parts]),
    )


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


def _goal_size(env: GoalEnvironment) -> int:
    return _sizes(env)[1]


def _sizes(env: GoalEnvironment) -> tuple[int, int, int]:
    """Sizes of the observation, of the goal and of the action."""
    obs = jax.eval_shape(env.reset, jax.random.key(0)).obs
    return obs["observation"].shape[-1], obs["desired_goal"].shape[-1], env.action_size
