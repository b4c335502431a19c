import jax.numpy as jnp
import numpy as np
import pytest

from cgm_jax.envs.observations import euler_angles, fetch_observation


def rotation(axis: int, angle: float) -> np.ndarray:
    cosine, sine = np.cos(angle), np.sin(angle)
    matrix = np.eye(3)
    others = [i for i in range(3) if i != axis]
    matrix[np.ix_(others, others)] = [[cosine, -sine], [sine, cosine]]
    return matrix if axis != 1 else matrix.T


def quaternion(axis: int, angle: float) -> np.ndarray:
    result = np.zeros(4)
    result[0], result[1 + axis] = np.cos(angle / 2), np.sin(angle / 2)
    return result


def product(p: np.ndarray, q: np.ndarray) -> np.ndarray:
    vector = p[0] * q[1:] + q[0] * p[1:] + np.cross(p[1:], q[1:])
    return np.array([p[0] * q[0] - p[1:] @ q[1:], *vector])


def euler_of_matrix(matrix: np.ndarray) -> np.ndarray:
    """Gymnasium-Robotics' formula away from gimbal lock."""
    cosine = np.hypot(matrix[2, 2], matrix[1, 2])
    return -np.array(
        [
            np.arctan2(matrix[1, 2], matrix[2, 2]),
            np.arctan2(-matrix[0, 2], cosine),
            np.arctan2(matrix[0, 1], matrix[0, 0]),
        ]
    )


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("angle", [-1.2, -0.3, 0.0, 0.7, 1.4])
def test_euler_angles_of_a_rotation_about_one_axis(axis: int, angle: float) -> None:
    expected = np.zeros(3)
    expected[axis] = angle
    actual = euler_angles(jnp.asarray(quaternion(axis, angle)))
    np.testing.assert_allclose(actual, expected, atol=1e-6)


def test_euler_angles_of_composed_rotations() -> None:
    generator = np.random.default_rng(0)
    for first, second, third in generator.uniform(-1.4, 1.4, (50, 3)):
        q = product(product(quaternion(0, first), quaternion(1, second)), quaternion(2, third))
        matrix = rotation(0, first) @ rotation(1, second) @ rotation(2, third)
        np.testing.assert_allclose(
            euler_angles(jnp.asarray(q, jnp.float32)), euler_of_matrix(matrix), atol=1e-5
        )


def test_euler_angles_are_finite_at_gimbal_lock() -> None:
    actual = euler_angles(jnp.asarray(quaternion(1, np.pi / 2), jnp.float32))
    assert np.isfinite(np.asarray(actual)).all()
    np.testing.assert_allclose(actual, [0.0, np.pi / 2, 0.0], atol=2e-3)


READINGS = {
    "grip_position": [1.0, 2.0, 3.0],
    "grip_velocity": [0.5, 0.25, 0.0],
    "object_position": [1.5, 2.5, 2.0],
    "object_orientation": [1.0, 0.0, 0.0, 0.0],
    "object_linear_velocity": [1.0, 0.25, -0.5],
    "object_angular_velocity": [1.0, 2.0, 3.0],
    "right_finger_position": [0.01],
    "left_finger_position": [0.02],
    "right_finger_velocity": [0.1],
    "left_finger_velocity": [-0.1],
}


def observe(*, has_object: bool, fingers_blocked: bool = False) -> np.ndarray:
    return np.asarray(
        fetch_observation(
            lambda name: jnp.array(READINGS[name]),
            has_object=has_object,
            fingers_blocked=fingers_blocked,
        )
    )


def test_the_layout_and_units_are_those_of_gymnasium_robotics() -> None:
    expected = [1, 2, 3, 1.5, 2.5, 2, 0.5, 0.5, -1, 0.01, 0.02, 0, 0, 0]
    expected += [0.02, 0, -0.02, 0.04, 0.08, 0.12, 0.02, 0.01, 0, 0.004, -0.004]
    np.testing.assert_allclose(observe(has_object=True), expected, atol=1e-7)


def test_without_an_object_its_entries_are_absent() -> None:
    expected = [1, 2, 3, 0.01, 0.02, 0.02, 0.01, 0, 0.004, -0.004]
    np.testing.assert_allclose(observe(has_object=False), expected, atol=1e-7)


def test_blocked_fingers_are_observed_shut() -> None:
    blocked, free = (observe(has_object=True, fingers_blocked=b) for b in (True, False))
    assert blocked[9:11].tolist() == [0.0, 0.0]
    np.testing.assert_array_equal(np.delete(blocked, [9, 10]), np.delete(free, [9, 10]))
