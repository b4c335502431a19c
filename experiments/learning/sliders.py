"""Twenty sliders that share a motor: a goal of many dimensions, each of which is easy alone.

Train on it with

    python -m cgm_jax.train --env experiments/learning/sliders.py:Sliders
"""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
from brax.envs.base import State


@dataclass(frozen=True)
class Sliders:
    """Positions of `size` sliders in [-1, 1]; each has its own force, all share one motor's power.

    An action is one force per slider, in [-1, 1]. The motor serves up to `power` units of force at
    once: where more is asked for, all forces shrink alike. One slider alone reaches its goal in
    four steps. All of them together need a third of what the motor serves in an episode, and on
    average stop within 0.045 of their goals, as the threshold is one on the distance over all kept
    dimensions. Doing nothing reaches one goal in four, and never all of them.
    """

    size: int = 20
    power: float = 4.0
    episode_length: int = 25
    distance_threshold: float = 0.2

    @property
    def action_size(self) -> int:
        """One force per slider."""
        return self.size

    def reset(self, rng: jax.Array) -> State:
        """All sliders in the middle, with random goals in [-0.8, 0.8]."""
        goal = jax.random.uniform(rng, (self.size,), minval=-0.8, maxval=0.8)
        return self._state(jnp.zeros(self.size), goal)

    def step(self, state: State, action: jax.Array) -> State:
        """Move by up to 0.25, as far as the motor's power lasts."""
        asked = jnp.sum(jnp.abs(action))
        force = action * jnp.minimum(1.0, self.power / jnp.maximum(asked, 1e-6))
        position = jnp.clip(state.obs["achieved_goal"] + 0.25 * force, -1.0, 1.0)
        return self._state(position, state.obs["desired_goal"])

    def _state(self, position: jax.Array, goal: jax.Array) -> State:
        achieved = jnp.linalg.norm(position - goal) < self.distance_threshold
        return State(
            pipeline_state=None,
            obs={
                "observation": position,
                "achieved_goal": position,
                "desired_goal": goal,
            },
            reward=jnp.where(achieved, 0.0, -1.0),
            done=jnp.zeros(()),
        )
