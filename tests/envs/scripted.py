"""Controllers written by hand, from observations alone."""

import jax
import jax.numpy as jnp
import numpy as np

from envs.fetch import FetchEnvironment

OPEN, SHUT = 1.0, -1.0


def push(observation: np.ndarray, goal: np.ndarray) -> np.ndarray:
    """Get behind the block, seen from the goal, then drive towards the goal."""
    grip, block = observation[:3], observation[3:6]
    way = (goal - block)[:2] / (np.linalg.norm((goal - block)[:2]) + 1e-6)
    behind = block[:2] - 0.07 * way
    off_line = np.linalg.norm(grip[:2] - behind)
    action = np.zeros(4)
    if np.dot(grip[:2] - block[:2], way) > -0.05 or off_line > 0.05:
        action[:2] = 15 * (behind - grip[:2])
        action[2] = 15 * ((0.5 if off_line > 0.03 else 0.42) - grip[2])
    else:
        action[:2] = 10 * (goal - block)[:2] + 5 * (behind - grip[:2])
        action[2] = 15 * (0.42 - grip[2])
    return np.clip(action, -1, 1)


def pick_and_place(observation: np.ndarray, goal: np.ndarray) -> np.ndarray:
    """Come down on the block with open fingers, shut them, carry it to the goal."""
    grip, block, offset, fingers = (observation[i:j] for i, j in ((0, 3), (3, 6), (6, 9), (9, 11)))
    if np.linalg.norm(offset) < 0.02 and fingers.max() < 0.028:
        return np.clip([*(12 * (goal - block)), SHUT], -1, 1)
    if np.linalg.norm(offset) < 0.012:
        return np.array([*np.clip(12 * offset, -1, 1), SHUT])
    above = np.linalg.norm(offset[:2]) > 0.012
    height = block[2] + (0.06 if above else 0.0)
    return np.clip([*(15 * offset[:2]), 15 * (height - grip[2]), OPEN], -1, 1)


CONTROLLERS = {"push": push, "pick_and_place": pick_and_place}


def success_rate(env: FetchEnvironment, task: str, episodes: int) -> float:
    """Share of episodes that the task's controller solves; fails on any physics warning."""
    step = jax.jit(jax.vmap(env.step))
    state = jax.jit(jax.vmap(env.reset))(jax.random.split(jax.random.key(3), episodes))
    for _ in range(env.episode_length):
        observation, goal = (np.asarray(state.obs[k]) for k in ("observation", "desired_goal"))
        pairs = zip(observation, goal, strict=True)
        actions = np.array([CONTROLLERS[task](o, g) for o, g in pairs], np.float32)
        state = step(state, jnp.asarray(actions))
        assert np.sum(state.metrics["physics_warnings"]) == 0
    return float(np.mean(state.metrics["success"]))
