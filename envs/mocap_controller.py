"""The mocap controller: MuJoCo's weld constraint as an inverse-kinematics solver.

A mocap body is welded to the gripper link. Moving the mocap body away from the gripper makes
the weld drag the 7-joint arm after it, so a Cartesian action needs no explicit inverse
kinematics. Follows Gymnasium-Robotics' Fetch: at each control step the target is placed
relative to where the gripper *is*, not to where it was told to be.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

METRES_PER_ACTION = 0.05
# Pointing down, as an unnormalised quaternion (w, x, y, z). Gymnasium-Robotics adds it to the
# gripper's quaternion at every step, which pulls the orientation back towards straight down.
DOWNWARD = (1.0, 0.0, 1.0, 0.0)


class ControlTarget(NamedTuple):
    """What the physics is told for one control step.

    Attributes:
        mocap_position: [3], metres, world frame.
        mocap_orientation: unit quaternion [4] (w, x, y, z), world frame.
        finger_command: target opening [2] of (right, left) finger, metres.
    """

    mocap_position: jax.Array
    mocap_orientation: jax.Array
    finger_command: jax.Array


class Gripper(NamedTuple):
    """The gripper as the sensors see it.

    Attributes:
        position: of the gripper link, [3], metres.
        orientation: of the gripper link, unit quaternion [4] (w, x, y, z).
        velocity: linear, [3], m/s.
        finger_positions: opening of (right, left) finger [2], metres.
    """

    position: jax.Array
    orientation: jax.Array
    velocity: jax.Array
    finger_positions: jax.Array


def control_target(action: jax.Array, gripper: Gripper, *, pose_lag: float = 0.0) -> ControlTarget:
    """Turn an action into the pose that the gripper is dragged towards.

    Args:
        action: [4] in [-1, 1], clipped here: displacement (x, y, z) in units of 5 cm, and the
            finger command, an opening relative to the present one.
        gripper: where it is.
        pose_lag: age in seconds of the gripper position that the displacement counts from.

    Returns:
        The target of this control step.
    """
    action = jnp.clip(action, -1.0, 1.0)
    displacement = METRES_PER_ACTION * action[:3] - pose_lag * gripper.velocity
    displacement -= weld_drift(action[:3])
    downward = jnp.asarray(DOWNWARD, dtype=gripper.orientation.dtype)
    # q and -q are one rotation; only the sum of those on the same side pulls towards it.
    side = jnp.where(jnp.dot(gripper.orientation, downward) < 0.0, -1.0, 1.0)
    orientation = side * gripper.orientation + downward
    return ControlTarget(
        mocap_position=gripper.position + displacement,
        mocap_orientation=orientation / jnp.linalg.norm(orientation),
        finger_command=gripper.finger_positions + action[3],
    )


def weld_drift(direction: jax.Array) -> jax.Array:
    """How far [3] (metres) a newer MuJoCo's weld carries the gripper off in one control step.

    MuJoCo 3.7 gave weld constraints a term of the Jacobian's time derivative, which
    Gymnasium-Robotics' recordings (3.3) do not have. The form was found by stepping both
    versions from 3,000 equal states, the coefficients by replaying recorded episodes: with the
    compensation the largest grip error of an episode falls from 1.4-2.7 cm to 0.2-0.5 cm.
    No choice of the weld's solref or solimp does the same.

    Args:
        direction: the first three entries of the action, in [-1, 1].
    """
    x, y, z = direction
    return jnp.stack([0.00052 * (x * x + y * y + z * z), -0.00081 * x * y, -0.00081 * x * z])
