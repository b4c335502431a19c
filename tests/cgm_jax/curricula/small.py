"""Training so small that a curriculum's effect on it shows within seconds."""

# Brax types the parts of its State as unknown.
# pyright: reportAttributeAccessIssue=false, reportOptionalMemberAccess=false

import dataclasses
import functools
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from brax.envs.base import State

from cgm_jax.config.settings import Hyperparameters, Settings
from cgm_jax.config.sizes import Sizes
from cgm_jax.envs import GoalEnvironment
from cgm_jax.loop.state import TrainingState
from cgm_jax.loop.training import make_trainer
from tests.cgm_jax.probe import TINY

SMALL = dataclasses.replace(TINY, environments=64, replay_transitions=100_000)


def sizes(goal: int, distance_threshold: float = 0.1) -> Sizes:
    """What a curriculum is told of a task with so many goal dimensions."""
    return Sizes(
        observation=1,
        goal=goal,
        action=1,
        inputs=1 + goal,
        episode_length=1,
        distance_threshold=distance_threshold,
        environments=64,
        evaluation_episodes=10,
        updates_at_once=4,
        critics=1,
        starts=None,
    )


@functools.cache
def compiled(
    env: GoalEnvironment, settings: Settings
) -> tuple[Callable[..., Any], Callable[..., Any]]:
    """`init` and `epoch`, jitted once, so that runs that differ in traced settings share them."""
    trainer = make_trainer(env, settings)
    return jax.jit(trainer.init), jax.jit(trainer.epoch)


def epochs(
    env: GoalEnvironment, hyper: Hyperparameters, settings: Settings = SMALL
) -> Iterator[tuple[TrainingState, dict[str, np.ndarray]]]:
    """Train one run: the state and the metrics of one epoch after the other."""
    start, epoch = compiled(env, settings)
    state = start(hyper)
    while True:
        state, metrics = epoch(state, hyper)
        yield state, jax.tree.map(np.asarray, metrics)


@dataclass(frozen=True)
class Chances:
    """One step and three sub-goals: the first always, the second never, the third sometimes.

    The third is up to chance, or with `by_action` up to the sign of the action.
    """

    by_action: bool = False
    action_size: int = 1
    episode_length: int = 1
    distance_threshold: float = 0.5

    def reset(self, rng: jax.Array) -> State:
        return self._state(jnp.zeros(3), jax.random.bernoulli(rng))

    def step(self, state: State, action: jax.Array) -> State:
        luck: Any = state.pipeline_state
        if self.by_action:
            luck = action[0] > 0
        third = jnp.where(luck, 1.0, -1.0)
        return self._state(jnp.zeros(3).at[2].set(third), state.pipeline_state)

    def _state(self, achieved_goal: jax.Array, luck: Any) -> State:
        obs = {
            "observation": jnp.ones(1),
            "achieved_goal": achieved_goal,
            "desired_goal": jnp.array([0.0, 10.0, 1.0]),
        }
        return State(pipeline_state=luck, obs=obs, reward=jnp.zeros(()), done=jnp.zeros(()))


@dataclass(frozen=True)
class Distances:
    """One step that ends at a distance of 0.15 or 0.25 from the goal, up to chance."""

    action_size: int = 1
    episode_length: int = 1
    distance_threshold: float = 0.1

    def reset(self, rng: jax.Array) -> State:
        return self._state(jnp.zeros(1), jax.random.bernoulli(rng))

    def step(self, state: State, action: jax.Array) -> State:
        del action
        luck: Any = state.pipeline_state
        return self._state(jnp.where(luck, 0.85, 0.75)[None], luck)

    def _state(self, achieved_goal: jax.Array, luck: Any) -> State:
        obs = {
            "observation": jnp.ones(1),
            "achieved_goal": achieved_goal,
            "desired_goal": jnp.ones(1),
        }
        return State(pipeline_state=luck, obs=obs, reward=jnp.zeros(()), done=jnp.zeros(()))
