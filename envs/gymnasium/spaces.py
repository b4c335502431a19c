"""Spaces of observations and actions, and observations of states."""

import numpy as np
from brax.envs.base import State
from gymnasium import spaces

from cgm_jax.envs.fetch import FetchEnvironment

MAX_OBSERVATION = 1000.0
"""Bound of the observation space: metres, radians, metres per control step. A robot's reach
and a falling block stay far below; what lies beyond is broken physics."""

Observation = dict[str, np.ndarray]


def observation_space(env: FetchEnvironment) -> spaces.Dict:
    """The space of `env`'s observations, float64 as in Gymnasium-Robotics."""
    limit = MAX_OBSERVATION
    return spaces.Dict(
        {
            name: spaces.Box(-limit, limit, (size,), np.float64)
            for name, size in env.observation_size.items()
        }
    )


def action_space(env: FetchEnvironment) -> spaces.Box:
    """The space of `env`'s actions."""
    return spaces.Box(-1.0, 1.0, (env.action_size,), np.float32)


def observation_of(state: State) -> Observation:
    """The observation of a state or a batch of states, in arrays of the caller's own."""
    return {name: np.array(value, np.float64) for name, value in dict(state.obs).items()}
