"""Success of exported policies, or of random actions, and the episodes behind it."""

from dataclasses import dataclass, replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from brax.envs.base import State
from flax import struct

from cgm_jax.config.fields import SettingError
from cgm_jax.config.grid import Group
from cgm_jax.config.settings import Hyperparameters, Settings
from cgm_jax.curricula.goals import is_achieved
from cgm_jax.envs import GoalEnvironment
from cgm_jax.envs.fetch import FetchEnvironment
from cgm_jax.envs.physics.protocol import PhysicsState
from cgm_jax.loop.environment import make_environment
from cgm_jax.loop.exploration import Exploration, draw_exploration
from cgm_jax.loop.rollout import Policy, Rollout, drawn_goals, reset, roll_out
from cgm_jax.replay.ring import Episodes
from cgm_jax.storage.policies import act, load_policy
from cgm_jax.storage.run_directory import RunDirectory

AXES = "xyz"
"""Letters of the first goal dimensions, as `--mask` names them."""


@dataclass(frozen=True)
class Plan:
    """What to evaluate on.

    Attributes:
        episodes: how many per policy.
        seed: of starts and goals, the same for every policy.
        mask: goal axes that count as achieved, letters of `AXES`; "" is the full goal.
        filmed: of how many episodes, the first ones, to keep every state.
        engine: physics engine to use instead of the one in the settings, or None.
    """

    episodes: int
    seed: int
    mask: str = ""
    filmed: int = 0
    engine: str | None = None


class Film(struct.PyTreeNode):
    """Whole episodes of a Fetch environment, K of them.

    Attributes:
        states: of the physics, leading axes [T + 1, K].
        desired_goal: [K, 3].
        achieved: whether the masked goal is, at every step, [K, T + 1] bool.
        valid: whether the physics held, [K] bool.
    """

    states: PhysicsState
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
        film: the filmed episodes, None where none were asked for.
    """

    env: GoalEnvironment
    episodes: int
    valid: int
    successes: int
    film: Film | None

    @property
    def success_rate(self) -> float:
        """Share of successes; 0 where no episode was valid."""
        return self.successes / max(1, self.valid)


def evaluate_directory(
    directory: RunDirectory, plan: Plan, only: str | None = None
) -> dict[str, Outcome]:
    """Outcome of every policy in a run directory, by run name.

    Runs without a policy, because their sweep was stopped early, are left out.

    Args:
        directory: what a sweep or a training run has written.
        plan: the episodes.
        only: name of the one run to evaluate; None for all.

    Raises:
        SettingError: a policy is malformed, there is none, or the plan does not fit the
            environment.
    """
    groups = directory.groups()
    if only is not None:
        groups = [
            replace(group, runs=tuple(run for run in group.runs if run.name == only))
            for group in groups
        ]
        if not any(group.runs for group in groups):
            raise SettingError(f"run: {directory.path} holds no run {only!r}")
    trained = [
        replace(group, runs=tuple(run for run in group.runs if directory.policy_path(run).exists()))
        for group in groups
    ]
    # All environments first, so that what does not fit is refused before anything compiles.
    pairs = [(planned_environment(one.settings, plan), one) for one in trained if one.runs]
    if not pairs:
        raise SettingError(f"{directory.path} holds no policy yet")
    results = {}
    for env, group in pairs:
        results |= _evaluate_group(env, group, directory, plan)
    return results


def evaluate_random(settings: Settings, plan: Plan) -> Outcome:
    """Outcome of uniformly random actions in the environment that `settings` names.

    Raises:
        SettingError: no such environment, or the plan does not fit it.
    """
    env = planned_environment(settings, plan)

    def policy(observation: jax.Array, goal: jax.Array, noise: Exploration | None) -> jax.Array:
        del observation, goal
        assert noise is not None
        return noise.random_action

    @jax.jit
    def play() -> tuple[jax.Array, jax.Array, Film | None]:
        shape = (env.episode_length, plan.episodes, env.action_size)
        # The seed's own key draws starts and goals, as for every policy.
        key = jax.random.fold_in(jax.random.key(plan.seed), 1)
        return _play(env, policy, plan, draw_exploration(key, shape, Hyperparameters()))

    successes, valid, film = play()
    return Outcome(env, plan.episodes, int(valid), int(successes), film)


def planned_environment(settings: Settings, plan: Plan) -> GoalEnvironment:
    """Make the environment that `settings` names, if the plan fits it.

    Raises:
        SettingError: it does not: a film of something other than Fetch, a mask with more
            dimensions than the goal.
    """
    if plan.engine is not None:
        settings = replace(settings, engine=plan.engine)
    env = make_environment(settings)
    if plan.filmed and not isinstance(env, FetchEnvironment):
        raise SettingError(f"video: only the Fetch tasks can be rendered, not {settings.env}")
    size = _goal_size(env)
    if beyond := [axis for axis in plan.mask if AXES.index(axis) >= size]:
        raise SettingError(f"mask: goals of {settings.env} have no {beyond[0]}")
    return env


def goal_mask(mask: str, goal_size: int) -> np.ndarray:
    """From letters of masked axes to 1 = keep, 0 = masked, [goal_size] float32."""
    kept = np.ones(goal_size, np.float32)
    kept[[AXES.index(axis) for axis in mask]] = 0.0
    return kept


def _evaluate_group(
    env: GoalEnvironment, group: Group, directory: RunDirectory, plan: Plan
) -> dict[str, Outcome]:
    try:
        policies = [load_policy(directory.policy_path(run)) for run in group.runs]
        stacked = jax.tree.map(lambda *leaves: np.stack(leaves), *policies)
    except ValueError as error:
        raise SettingError(str(error)) from None

    def play(arrays: dict[str, jax.Array]) -> tuple[jax.Array, jax.Array, Film | None]:
        def policy(observation: jax.Array, goal: jax.Array, _: Exploration | None) -> jax.Array:
            return act(arrays, observation, goal, goal_mask(plan.mask, _goal_size(env)))

        return _play(env, policy, plan)

    successes, valid, film = jax.jit(jax.vmap(play))(stacked)
    return {
        run.name: Outcome(
            env=env,
            episodes=plan.episodes,
            valid=int(valid[i]),
            successes=int(successes[i]),
            film=jax.tree.map(lambda leaf, i=i: leaf[i], film),
        )
        for i, run in enumerate(group.runs)
    }


def _play(
    env: GoalEnvironment, policy: Policy, plan: Plan, exploration: Exploration | None = None
) -> tuple[jax.Array, jax.Array, Film | None]:
    """Successes, valid episodes, and the film of one policy's episodes."""
    mask = jnp.asarray(goal_mask(plan.mask, _goal_size(env)))
    first = reset(env, jax.random.key(plan.seed), plan.episodes)
    goals = drawn_goals(env, first)
    goals = goals.replace(mask=jnp.broadcast_to(mask, goals.mask.shape))

    def keep(state: State) -> PhysicsState | None:
        return _first(plan.filmed, state.pipeline_state) if plan.filmed else None

    rollout = roll_out(env, policy, first, goals, exploration, keep=keep)
    outcomes = rollout.outcomes
    film = _film(rollout, plan.filmed) if plan.filmed else None
    return jnp.sum(outcomes.valid & outcomes.success), jnp.sum(outcomes.valid), film


def _film(rollout: Rollout, count: int) -> Film:
    shown: Episodes = _first(count, rollout.episodes)
    goal, mask, threshold = (x[:, None] for x in (shown.desired_goal, shown.mask, shown.threshold))
    return Film(
        states=rollout.record,
        desired_goal=shown.desired_goal,
        achieved=is_achieved(goal, mask, shown.achieved_goal, threshold),
        valid=rollout.outcomes.valid[:count],
    )


def _first(count: int, tree: Any) -> Any:
    return jax.tree.map(lambda leaf: leaf[:count], tree)


def _goal_size(env: GoalEnvironment) -> int:
    first = jax.eval_shape(env.reset, jax.random.key(0))
    return first.obs["desired_goal"].shape[-1]
