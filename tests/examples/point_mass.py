"""A point in the plane that must be pushed to a goal: an environment of one's own, in one file.

Train on it with

    python -m cgm_jax.train --env tests/examples/point_mass.py:PointMass
"""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from brax.envs.base import State


@dataclass(frozen=True)
class PointMass:
    """A point in the plane with a velocity; the action is a force. It begins in [-1, 1]^2."""

    action_size: int = 2
    episode_length: int = 25
    distance_threshold: float = 0.1

    def reset(self, rng: jax.Array) -> State:
        """Rest at a random place, with a random goal."""
        position, goal = jax.random.uniform(rng, (2, 2), minval=-1.0, maxval=1.0)
        return self._state(position, jnp.zeros(2), goal)

    def restart(self, state: State) -> State:
        """Optional: an episode may begin in a state that another visited."""
        return state

    def step(self, state: State, action: jax.Array) -> State:
        """Semi-implicit Euler with friction, for 0.1 s."""
        position, velocity = jnp.split(state.obs["observation"], 2)
        velocity = 0.7 * velocity + 0.5 * action
        return self._state(position + 0.1 * velocity, velocity, state.obs["desired_goal"])

    def render_frame(self, state: State, width: int, height: int) -> np.ndarray:
        """Optional: a frame for videos, of [-2, 2]^2; the goal is green, the point black."""
        frame = np.full((height, width, 3), 255, np.uint8)
        for entry, colour in (("desired_goal", (0, 160, 0)), ("achieved_goal", (0, 0, 0))):
            x, y = np.clip((state.obs[entry] + 2.0) / 4.0, 0.0, 1.0)
            row, column = int((1.0 - y) * height), int(x * width)
            frame[max(row - 2, 0) : row + 2, max(column - 2, 0) : column + 2] = colour
        return frame

    def _state(self, position: jax.Array, velocity: jax.Array, goal: jax.Array) -> State:
        achieved = jnp.linalg.norm(position - goal) < self.distance_threshold
        return State(
            pipeline_state=None,
            obs={
                "observation": jnp.concatenate([position, velocity]),
                "achieved_goal": position,
                "desired_goal": goal,
            },
            reward=jnp.where(achieved, 0.0, -1.0),
            done=jnp.zeros(()),
        )
