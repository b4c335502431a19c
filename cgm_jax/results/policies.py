"""Success of exported policies, or of random actions, and the episodes behind it."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np

from cgm_jax.config.fields import SettingError
from cgm_jax.config.settings import Hyperparameters, Settings
from cgm_jax.envs import GoalEnvironment
from cgm_jax.loop.exploration import Exploration, draw_exploration
from cgm_jax.results.chosen import Policies
from cgm_jax.results.episodes import Chunk, Outcome, Progress, Result, play_all, play_chunk
from cgm_jax.results.plan import Plan, goal_mask
from cgm_jax.results.planned_environment import environment_sizes, planned_environment
from cgm_jax.storage.policies import act, load_policy

NOISE = 2**31
"""What makes the key of an episode's noise of its own; a reset splits that in far fewer."""


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
        return play_chunk(env, _random_policy, plan, chunk, recorded, noise)

    (outcome,) = play_all(env, play, {"none": np.zeros((1, 0))}, 1, plan, progress)
    return outcome


def _random_policy(observation: jax.Array, goal: jax.Array, noise: Exploration | None) -> jax.Array:
    del observation, goal
    if noise is None:
        raise ValueError("random actions need noise")
    return noise.random_action


def _evaluate_files(
    env: GoalEnvironment, files: Mapping[str, Path], plan: Plan, progress: Progress
) -> dict[str, Outcome]:
    sizes, paths = environment_sizes(env), list(files.values())
    mask = goal_mask(plan.mask, sizes[1])
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
            return act(arrays, observation, goal, mask)

        return play_chunk(env, policy, plan, chunk, recorded)

    outcomes = play_all(env, play, stacked, len(files), plan, progress)
    return dict(zip(files, outcomes, strict=True))
