"""Success of exported policies."""

import jax
import jax.numpy as jnp
import numpy as np

from cgm_jax.environments import make_environment
from cgm_jax.exploration import Exploration
from cgm_jax.grid import Group
from cgm_jax.policy import act, load_policy
from cgm_jax.rollout import roll_out
from cgm_jax.run_directory import RunDirectory
from cgm_jax.settings import SettingError


def evaluate_directory(
    directory: RunDirectory, episodes: int, seed: int
) -> dict[str, tuple[int, int]]:
    """Successes and valid episodes of every policy in a run directory, by run name.

    Runs without a policy, because their sweep was stopped early, are left out.

    Raises:
        SettingError: a policy is malformed, or there is none at all.
    """
    results = {}
    for group in directory.groups():
        results |= _evaluate_group(group, directory, episodes, seed)
    if not results:
        raise SettingError(f"{directory.path} holds no policy yet")
    return results


def _evaluate_group(
    group: Group, directory: RunDirectory, episodes: int, seed: int
) -> dict[str, tuple[int, int]]:
    env = make_environment(group.settings)
    goal_size = jax.eval_shape(env.reset, jax.random.key(0)).obs["desired_goal"].shape[-1]
    masks = jnp.ones((episodes, goal_size))

    def success(arrays: dict[str, jax.Array]) -> tuple[jax.Array, jax.Array]:
        def policy(observation: jax.Array, goal: jax.Array, _: Exploration | None) -> jax.Array:
            return act(arrays, observation, goal)

        rollout = roll_out(env, policy, jax.random.key(seed), masks)
        return jnp.sum(rollout.valid & rollout.success), jnp.sum(rollout.valid)

    runs = [run for run in group.runs if directory.policy_path(run).exists()]
    if not runs:
        return {}
    try:
        policies = [load_policy(directory.policy_path(run)) for run in runs]
        stacked = jax.tree.map(lambda *leaves: np.stack(leaves), *policies)
    except ValueError as error:
        raise SettingError(str(error)) from None
    successes, valid = jax.jit(jax.vmap(success))(stacked)
    return {run.name: (int(successes[i]), int(valid[i])) for i, run in enumerate(runs)}
