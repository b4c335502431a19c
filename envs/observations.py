"""From named sensor readings to the observation of Gymnasium-Robotics' Fetch tasks.

The MJCF in assets/fetch/ lists the sensors; every engine evaluates that one list, so that one
function serves them all.
"""

from collections.abc import Callable

import jax
import jax.numpy as jnp

SECONDS_PER_CONTROL_STEP = 0.04
"""Control runs at 25 Hz. Velocities are observed per control step (m/s x 0.04 s)."""

GRIP_POSITION = slice(0, 3)
"""Entries of an observation."""

OBJECT_POSITION = slice(3, 6)
"""Entries of an observation with an object."""

Reading = Callable[[str], jax.Array]
"""Looks a sensor up by its name in the MJCF."""


def euler_angles(quaternion: jax.Array) -> jax.Array:
    """Intrinsic x-y-z Euler angles [3] (radians) of a unit quaternion [4] (w, x, y, z).

    So scipy's `Rotation.from_euler("XYZ", angles)` is the rotation.

    The convention of Gymnasium-Robotics' `mat2euler`, which observes the object's rotation.
    At gimbal lock (pitch of +-90 degrees) the first angle is 0, as there.
    """
    w, x, y, z = quaternion
    # The entries of the rotation matrix that the angles depend on.
    r00, r01, r02 = 1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)
    r10, r11 = 2 * (x * y + w * z), 1 - 2 * (x * x + z * z)
    r12, r22 = 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)
    cosine_of_pitch = jnp.hypot(r12, r22)
    locked = cosine_of_pitch < 1e-6
    roll = jnp.where(locked, 0.0, -jnp.arctan2(r12, jnp.where(locked, 1.0, r22)))
    pitch = -jnp.arctan2(-r02, cosine_of_pitch)
    yaw = jnp.where(
        locked,
        -jnp.arctan2(-r10, r11),
        -jnp.arctan2(jnp.where(locked, 0.0, r01), jnp.where(locked, 1.0, r00)),
    )
    return jnp.stack([roll, pitch, yaw])


def fetch_observation(reading: Reading, *, has_object: bool, fingers_blocked: bool) -> jax.Array:
    """The observation, [25] with an object and [10] without.

    Entries, as in Gymnasium-Robotics: grip position 3, (object position 3, object - grip 3,)
    finger joints 2, (object Euler angles 3, object linear velocity relative to grip 3, object
    angular velocity 3,) grip velocity 3, finger velocities 2. Metres and radians; velocities
    per control step. Blocked fingers are observed at 0, where the next control step puts them.
    Without blocked fingers Gymnasium-Robotics observes the positions of grip and object as they
    were one substep of 2 ms before; here they are those of now, so up to 2 mm ahead at full speed.
    """
    grip = reading("grip_position")
    grip_velocity = reading("grip_velocity") * SECONDS_PER_CONTROL_STEP
    fingers = [reading("right_finger_position"), reading("left_finger_position")]
    if fingers_blocked:
        fingers = [jnp.zeros_like(position) for position in fingers]
    finger_velocities = [
        reading("right_finger_velocity") * SECONDS_PER_CONTROL_STEP,
        reading("left_finger_velocity") * SECONDS_PER_CONTROL_STEP,
    ]
    if not has_object:
        return jnp.concatenate([grip, *fingers, grip_velocity, *finger_velocities])
    position = reading("object_position")
    return jnp.concatenate(
        [
            grip,
            position,
            position - grip,
            *fingers,
            euler_angles(reading("object_orientation")),
            reading("object_linear_velocity") * SECONDS_PER_CONTROL_STEP - grip_velocity,
            reading("object_angular_velocity") * SECONDS_PER_CONTROL_STEP,
            grip_velocity,
            *finger_velocities,
        ]
    )
