"""Controllers written by hand, from observations alone, for a whole batch at once.

A controller takes observations [E, 25], desired goals [E, 3] and the number of the step, and
returns actions [E, 4].
"""

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np

from cgm_jax.envs.fetch import FetchEnvironment
from cgm_jax.envs.quiet_import import State

Controller = Callable[[np.ndarray, np.ndarray, int], np.ndarray]

OPEN, SHUT = 1.0, -1.0
LOW, HIGH = 0.42, 0.5  # heights of the grip: beside the block, and above it with shut fingers


def push(observation: np.ndarray, goal: np.ndarray, step: int) -> np.ndarray:
    """Fly behind the block, seen from the goal, come down, and push it along the line to it."""
    grip, block = observation[:, :3], observation[:, 3:6]
    way, left = _unit((goal - block)[:, :2])
    offset = (grip - block)[:, :2]
    distance = np.linalg.norm(offset, axis=1, keepdims=True)
    along = np.sum(offset * way, axis=1, keepdims=True)
    aside = offset - along * way
    behind = block[:, :2] - 0.075 * way
    off = np.linalg.norm(grip[:, :2] - behind, axis=1, keepdims=True)
    in_line = (along < -0.02) & (np.linalg.norm(aside, axis=1, keepdims=True) < 0.02)
    pushing = in_line & (grip[:, 2:] < LOW + 0.025)
    # The block coasts a little, so slow down on the way.
    forward = way * np.clip(8 * left, 0.0, 1.0) - 15 * aside
    # Up before across, lest the block be hit from the wrong side.
    clear = (grip[:, 2:] > HIGH - 0.025) | (off < 0.02) | (distance > 0.1)
    across = np.where(clear, 15 * (behind - grip[:, :2]), 0.0)
    height = np.where(pushing | (off < 0.02), LOW, HIGH)
    action = np.concatenate(
        [
            np.where(pushing, forward, across),
            15 * (height - grip[:, 2:]),
            np.zeros_like(left),
        ],
        axis=1,
    )
    return np.clip(np.where(left > 0.015, action, 0.0), -1.0, 1.0)


def pick_and_place(observation: np.ndarray, goal: np.ndarray, step: int) -> np.ndarray:
    """Come down on the block with open fingers, shut them, carry it to the goal."""
    grip, block, offset = observation[:, :3], observation[:, 3:6], observation[:, 6:9]
    fingers = observation[:, 9:11].max(axis=1, keepdims=True)
    distance = np.linalg.norm(offset, axis=1, keepdims=True)
    carry = np.concatenate([12 * (goal - block), np.full_like(distance, SHUT)], axis=1)
    grasp = np.concatenate([12 * offset, np.full_like(distance, SHUT)], axis=1)
    aside = np.linalg.norm(offset[:, :2], axis=1, keepdims=True) > 0.012
    height = block[:, 2:] + np.where(aside, 0.06, 0.0)
    approach = np.concatenate(
        [15 * offset[:, :2], 15 * (height - grip[:, 2:]), np.full_like(distance, OPEN)], axis=1
    )
    action = np.where(distance < 0.012, grasp, approach)
    action = np.where((distance < 0.02) & (fingers < 0.028), carry, action)
    return np.clip(action, -1.0, 1.0)


def free_motion(observation: np.ndarray, goal: np.ndarray, step: int) -> np.ndarray:
    """Up first, so that nothing is touched, and then about at random."""
    action = np.random.default_rng(step).uniform(-1.0, 1.0, (len(goal), 4))
    action[:, 2] = 1.0 if step < 6 else action[:, 2] / 2
    return action


def _unit(vectors: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Directions and lengths [E, 1] of vectors [E, n]."""
    lengths = np.linalg.norm(vectors, axis=1, keepdims=True)
    return vectors / np.maximum(lengths, 1e-6), lengths


CONTROLLERS: dict[str, Controller] = {"push": push, "pick_and_place": pick_and_place}


class Player:
    """Plays batches of episodes; compiles once per size of the batch."""

    def __init__(self, env: FetchEnvironment) -> None:
        self.env = env
        self._reset, self._step = jax.jit(jax.vmap(env.reset)), jax.jit(jax.vmap(env.step))

    def play(self, controller: Controller, episodes: int) -> list[State]:
        """The states [T + 1] of a batch of episodes, whose starts and goals are always the same."""
        states = [self._reset(jax.random.split(jax.random.key(3), episodes))]
        for i in range(self.env.episode_length):
            observation, goal = (
                np.asarray(states[-1].obs[name]) for name in ("observation", "desired_goal")
            )
            action = np.asarray(controller(observation, goal, i), np.float32)
            states.append(self._step(states[-1], jnp.asarray(action)))
        return states


def success(states: list[State]) -> np.ndarray:
    """Whether the last step achieves the goal, [E]."""
    return np.asarray(states[-1].metrics["success"]) > 0
