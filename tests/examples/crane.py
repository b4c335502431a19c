"""A hook that must take a load to a place: an environment whose goal has stages on the way.

The load lies still until the hook is at it and closes, so that hindsight about the load alone has
nothing to learn from. Train on it with

    python -m cgm_jax.train --env tests/examples/crane.py:Crane --relabelling relay
"""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
from brax.envs.base import State

from cgm_jax.envs import Stage

REACH = 0.1
"""A hook that closes nearer than this to the load holds it."""


@dataclass(frozen=True)
class Crane:
    """Places of hook and load in [-1, 1]^2, and whether the hook holds the load.

    The action displaces the hook; its third entry closes the hook where it is above 0.
    """

    action_size: int = 3
    episode_length: int = 25
    distance_threshold: float = 0.1

    @property
    def stages(self) -> tuple[Stage, ...]:
        """First the hook is at the load, then it holds it."""
        at_the_load = Stage(
            achieved=lambda observation: observation[2:4] - observation[:2],
            desired=lambda observation, goal: jnp.zeros(2),
            size=2,
            distance_threshold=REACH,
        )
        holds = Stage(
            achieved=lambda observation: observation[4:],
            desired=lambda observation, goal: jnp.ones(1),
            size=1,
            distance_threshold=0.5,
        )
        return at_the_load, holds

    def reset(self, rng: jax.Array) -> State:
        """Random places of hook, load and goal."""
        hook, load, goal = jax.random.uniform(rng, (3, 2), minval=-1.0, maxval=1.0)
        return self._state(hook, load, jnp.zeros(()), goal)

    def step(self, state: State, action: jax.Array) -> State:
        """Close or open the hook, then move it, and the load with it if it is held."""
        hook, load = state.obs["observation"][:2], state.obs["observation"][2:4]
        near = jnp.linalg.norm(load - hook) < REACH
        held = jnp.where(near & (action[2] > 0.0), 1.0, 0.0)
        moved = jnp.clip(hook + 0.2 * action[:2], -1.0, 1.0)
        load = load + held * (moved - hook)
        return self._state(moved, load, held, state.obs["desired_goal"])

    def _state(self, hook: jax.Array, load: jax.Array, held: jax.Array, goal: jax.Array) -> State:
        obs = {
            "observation": jnp.concatenate([hook, load, held[None]]),
            "achieved_goal": load,
            "desired_goal": goal,
        }
        return State(pipeline_state=None, obs=obs, reward=jnp.zeros(()), done=jnp.zeros(()))
