"""What the checks of physics measure along a batch of episodes."""

# Brax types the parts of its State as unknown.
# pyright: reportAttributeAccessIssue=false, reportOptionalMemberAccess=false

import itertools

import numpy as np

from cgm_jax.envs.fetch import FetchEnvironment
from cgm_jax.envs.observations import SECONDS_PER_CONTROL_STEP
from cgm_jax.envs.quiet_import import State


def observations(states: list[State]) -> np.ndarray:
    """Observations [T + 1, E, 25] of a batch of episodes."""
    return np.array([state.obs["observation"] for state in states])


def warnings(states: list[State]) -> float:
    """Physics warnings of all steps and episodes together."""
    return float(np.sum([state.metrics["physics_warnings"] for state in states]))


def object_speed(states: list[State]) -> np.ndarray:
    """Speed of the object [T + 1, E] in m/s; it is observed relative to the grip."""
    observed = observations(states)
    velocity = observed[..., 14:17] + observed[..., 20:23]
    return np.linalg.norm(velocity, axis=-1) / SECONDS_PER_CONTROL_STEP


def finger_depth(env: FetchEnvironment, states: list[State]) -> np.ndarray:
    """How deep the corners of the fingers are inside the table [T + 1, E], metres.

    The distance to the table's nearest face of the deepest corner; below 0 outside.
    """
    model, sensors = env.scene.model, env.scene.sensors
    readings = np.array([state.pipeline_state.sensors for state in states])
    grip = readings[..., sensors["gripper_position"]]
    rotation = _rotation(readings[..., sensors["gripper_orientation"]])
    table = model.geom("table")
    depth = np.full(grip.shape[:-1], -np.inf)
    for name in ("right_finger", "left_finger"):
        geom, axis = model.geom(name), model.joint(name).axis
        opening = readings[..., sensors[f"{name}_position"]]
        centre = model.body(f"{name}_link").pos + geom.pos + opening * axis
        for signs in itertools.product((-1, 1), repeat=3):
            corner = grip + np.einsum("...ij,...j->...i", rotation, centre + signs * geom.size)
            inside = np.min(table.size - np.abs(corner - table.pos), axis=-1)
            depth = np.maximum(depth, inside)
    return depth


def _rotation(quaternion: np.ndarray) -> np.ndarray:
    """Rotation matrices [..., 3, 3] of unit quaternions [..., 4] (w, x, y, z)."""
    w, x, y, z = np.moveaxis(quaternion, -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)
