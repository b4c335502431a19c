"""A point in the plane that must be pushed to a goal: a Gymnasium goal environment in numpy.

The rules of point_mass.py, for libraries that train without JAX; and here, where it is stepped in a
process of its own:

    python -m cgm_jax.train --env gymnasium:tests.examples.numpy_point_mass:NumpyPointMass-v0
"""

from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces

Observation = dict[str, np.ndarray]


class NumpyPointMass(gymnasium.Env[Any, np.ndarray]):
    """Position and velocity; the action is a force, and an episode takes 25 steps."""

    distance_threshold = 0.1
    episode_length = 25

    def __init__(self) -> None:
        """Goals lie in [-1, 1]^2; the point may leave that square, but gets no further than 6."""
        self.observation_space = spaces.Dict(
            {
                "observation": spaces.Box(-6.0, 6.0, (4,), np.float64),
                "achieved_goal": spaces.Box(-6.0, 6.0, (2,), np.float64),
                "desired_goal": spaces.Box(-1.0, 1.0, (2,), np.float64),
            }
        )
        self.action_space = spaces.Box(-1.0, 1.0, (2,), np.float32)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Rest at a random place, with a random goal."""
        super().reset(seed=seed)
        self._position, self._goal = self.np_random.uniform(-1.0, 1.0, (2, 2))
        self._velocity, self._steps = np.zeros(2), 0
        return self._observation(), {}

    def step(self, action: np.ndarray) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Semi-implicit Euler with friction, for 0.1 s."""
        self._velocity = 0.7 * self._velocity + 0.5 * np.asarray(action, np.float64)
        self._position = self._position + 0.1 * self._velocity
        self._steps += 1
        reward = self.compute_reward(self._position, self._goal, {})
        truncated = self._steps >= self.episode_length
        return self._observation(), float(reward), False, truncated, {}

    def compute_reward(self, achieved_goal: np.ndarray, desired_goal: np.ndarray, info: Any) -> Any:
        """0 where goals [..., 2] are achieved, -1 elsewhere; [...]."""
        distance = np.linalg.norm(achieved_goal - desired_goal, axis=-1)
        return np.where(distance < self.distance_threshold, 0.0, -1.0)[()]

    def _observation(self) -> Observation:
        return {
            "observation": np.concatenate([self._position, self._velocity]),
            "achieved_goal": self._position.copy(),
            "desired_goal": self._goal.copy(),
        }


gymnasium.register("NumpyPointMass-v0", f"{__name__}:NumpyPointMass", max_episode_steps=25)
