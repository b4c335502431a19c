"""Goal environments that differ from the point mass in what a task is made of."""

from typing import Any

import gymnasium
import numpy as np

from tests.examples.numpy_point_mass import NumpyPointMass


class OneForSuccess(NumpyPointMass):
    """Rewards 1 and 0, for one goal at a time, and keeps its threshold to itself."""

    distance_threshold = property()  # pyright: ignore[reportAssignmentType]

    def compute_reward(self, achieved_goal: np.ndarray, desired_goal: np.ndarray, info: Any) -> Any:
        off = abs(float(achieved_goal[0]) - float(desired_goal[0]))
        return float(off < 0.3 and abs(float(achieved_goal[1]) - float(desired_goal[1])) < 0.2)


class Dense(NumpyPointMass):
    """Rewards that are distances; says of a goal that is not achieved that it is."""

    def compute_reward(self, achieved_goal: np.ndarray, desired_goal: np.ndarray, info: Any) -> Any:
        return -np.linalg.norm(achieved_goal - desired_goal, axis=-1)

    def step(self, action: np.ndarray) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        return (*super().step(action)[:4], {"is_success": True})


class Ending(NumpyPointMass):
    """Terminates after so many steps as its first position says; some are truncated."""

    def step(self, action: np.ndarray) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        if self._steps == 0:
            self._end = 3 + int(abs(self._position[0]) * 40)
        shown, reward, _, truncated, info = super().step(action)
        last = self._steps >= self._end
        cut = bool(self._goal[0] < 0.0)
        return shown, reward, last and not cut, truncated or (last and cut), info


class NoRule(Dense):
    distance_threshold = None  # pyright: ignore[reportAssignmentType]


for name in ("OneForSuccess", "Dense", "Ending", "NoRule"):
    gymnasium.register(f"tests/{name}-v0", f"{__name__}:{name}", max_episode_steps=25)
gymnasium.register("tests/Endless-v0", f"{NumpyPointMass.__module__}:NumpyPointMass")
