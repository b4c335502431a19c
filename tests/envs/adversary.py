"""Actions that try to break the physics: as fast, as hard and as sudden as the tasks allow."""

import numpy as np

from experiments.physics.scripted import SHUT, Controller, pick_and_place, push


def reverse(observation: np.ndarray, goal: np.ndarray, step: int) -> np.ndarray:
    """Full speed along every axis, to and fro in one step to ten; half of them at the object."""
    episode = np.arange(len(goal))[:, None]
    half_period = 1 + (episode * (1 + np.arange(4))) % 5
    action = np.where(step // half_period % 2 == 0, 1.0, -1.0)
    approaching = (episode % 2 == 0) & (step < 10)
    return np.where(approaching, pick_and_place(observation, goal, step), action)


def press_into_table(observation: np.ndarray, goal: np.ndarray, step: int) -> np.ndarray:
    """Straight down with all force, later dragging the fingers across the table."""
    angle = np.arange(len(goal)) + step // 5
    across = np.stack([np.cos(angle), np.sin(angle)], axis=1) * (step > 20)
    return np.concatenate([across, np.full((len(goal), 2), -1.0)], axis=1)


def press_onto_object(observation: np.ndarray, goal: np.ndarray, step: int) -> np.ndarray:
    """Over the object with shut fingers, then down onto it with all force."""
    offset = observation[:, 6:9]
    near = np.linalg.norm(offset[:, :2], axis=1, keepdims=True) < 0.02
    down = np.where(near, -1.0, 15 * (0.52 - observation[:, 2:3]))
    action = np.concatenate([15 * offset[:, :2], down, np.full_like(down, SHUT)], axis=1)
    return np.clip(action, -1.0, 1.0)


def squeeze_and_shake(observation: np.ndarray, goal: np.ndarray, step: int) -> np.ndarray:
    """Grasp the object, shut the fingers with all force, and shake it, or drive it down."""
    shaking = reverse(observation, goal, step)
    shaking[:, 3] = SHUT
    shaking[::2, 2] = -1.0
    held = (step > 20) & (np.linalg.norm(observation[:, 6:9], axis=1, keepdims=True) < 0.04)
    return np.where(held, shaking, pick_and_place(observation, goal, step))


def shove_off_table(observation: np.ndarray, goal: np.ndarray, step: int) -> np.ndarray:
    """At full speed through the object, towards one of the table's edges, and on."""
    block = observation[:, 3:6]
    angle = np.pi / 2 * np.arange(len(goal))
    beyond = block + np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    return push(observation, beyond, step)


ADVERSARIES: tuple[Controller, ...] = (
    reverse,
    press_into_table,
    press_onto_object,
    squeeze_and_shake,
    shove_off_table,
)


def attack(observation: np.ndarray, goal: np.ndarray, step: int) -> np.ndarray:
    """Every adversary on its share of the batch."""
    chosen = np.arange(len(goal)) % len(ADVERSARIES)
    actions = np.empty((len(goal), 4))
    for i, adversary in enumerate(ADVERSARIES):
        rows = chosen == i
        actions[rows] = adversary(observation[rows], goal[rows], step)
    return actions
