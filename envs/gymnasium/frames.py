"""Rendered frames of an environment's states."""

# Brax types the parts of its State as unknown.
# pyright: reportArgumentType=false

from collections.abc import Iterator
from typing import Any

import gymnasium
import numpy as np
from brax.envs.base import State

from cgm_jax.envs.gymnasium.programs import FetchPrograms
from cgm_jax.envs.gymnasium.spaces import observation_of
from cgm_jax.envs.numpy_goals import is_achieved
from cgm_jax.envs.rendering import Renderer, check_size


class Frames:
    """Draws states, on a surface that opens at the first one. A copy opens its own."""

    def __init__(self, programs: FetchPrograms, width: int, height: int) -> None:
        """Note what to draw and how large, in pixels.

        Raises:
            TypeError: a size is no integer.
            ValueError: a frame of no size, or larger than the model's off-screen buffer.
        """
        check_size(programs.env.scene, width, height)
        self._programs, self._size = programs, (width, height)
        self._renderer: Renderer | None = None

    def draw(self, states: State) -> Iterator[np.ndarray]:
        """A frame [height, width, 3] uint8 of each of n states, green where it is achieved.

        Raises:
            RenderingError: this machine cannot render.
        """
        env = self._programs.env
        if self._renderer is None:
            self._renderer = Renderer(env.scene, env.distance_threshold, *self._size)
        observation = observation_of(states)
        desired = observation["desired_goal"]
        achieved = is_achieved(observation["achieved_goal"], desired, env.distance_threshold)
        rows = env.physics.positions(states.pipeline_state)
        for row, goal, reached in zip(rows, desired, np.atleast_1d(achieved), strict=True):
            yield self._renderer.frame(row, goal, achieved=bool(reached))

    def close(self) -> None:
        """Free what drawing took. Any number of times."""
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None

    def __reduce__(self) -> tuple[Any, ...]:
        return Frames, (self._programs, *self._size)


def warn_without_render_mode(env_id: str) -> None:
    """Warn as Gymnasium's own environments do where `render` has nothing to return."""
    gymnasium.logger.warn(
        "You are calling render method without specifying any render mode. Write "
        f'gymnasium.make("{env_id}", render_mode="rgb_array")'
    )
