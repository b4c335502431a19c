import jax.numpy as jnp
import numpy as np
import pytest

from cgm_jax.envs.mocap_controller import Gripper, control_target, weld_drift

DOWN = np.array([1.0, 0.0, 1.0, 0.0]) / np.sqrt(2)


def gripper(orientation: np.ndarray = DOWN, velocity: tuple[float, ...] = (0, 0, 0)) -> Gripper:
    return Gripper(
        position=jnp.array([1.3, 0.7, 0.5]),
        orientation=jnp.asarray(orientation, jnp.float32),
        velocity=jnp.array(velocity, jnp.float32),
        finger_positions=jnp.array([0.01, 0.02]),
    )


def test_an_action_is_a_displacement_in_units_of_five_centimetres() -> None:
    target = control_target(jnp.array([1.0, -0.5, 0.2, -1.0]), gripper())
    np.testing.assert_allclose(target.mocap_position, [1.35, 0.675, 0.51], atol=1e-3)
    np.testing.assert_allclose(target.finger_command, [-0.99, -0.98], rtol=1e-6)


def test_actions_beyond_one_are_clipped() -> None:
    target = control_target(jnp.array([7.0, -7.0, 0.0, 7.0]), gripper())
    np.testing.assert_allclose(target.mocap_position, [1.35, 0.65, 0.5], atol=2e-3)
    np.testing.assert_allclose(target.finger_command, [1.01, 1.02], rtol=1e-6)


def test_a_late_position_is_where_the_gripper_was() -> None:
    late = control_target(jnp.zeros(4), gripper(velocity=(0.5, 0.0, -1.0)), pose_lag=0.002)
    np.testing.assert_allclose(late.mocap_position, [1.299, 0.7, 0.502], rtol=1e-6)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_orientation_is_pulled_towards_straight_down(sign: float) -> None:
    tilted = np.array([0.8, 0.0, 0.6, 0.0])
    target = control_target(jnp.zeros(4), gripper(sign * tilted))
    # (0.8, 0, 0.6, 0) + (1, 0, 1, 0), normalised; the other side of the double cover is the same.
    expected = sign * np.array([1.8, 0.0, 1.6, 0.0]) / np.hypot(1.8, 1.6)
    assert abs(np.dot(target.mocap_orientation, expected)) == pytest.approx(1.0, abs=1e-6)
    assert np.linalg.norm(target.mocap_orientation) == pytest.approx(1.0, abs=1e-6)


def test_the_weld_compensation_by_hand() -> None:
    # x y = -0.5, x z = 0.2 and a squared length of 1.29.
    action = jnp.array([1.0, -0.5, 0.2, 0.0])
    drift = np.array([0.00052 * 1.29, 0.00081 * 0.5, -0.00081 * 0.2])
    np.testing.assert_allclose(weld_drift(action[:3]), drift, rtol=1e-5)
    target = control_target(action, gripper())
    np.testing.assert_allclose(
        target.mocap_position, [1.35 - drift[0], 0.675 - drift[1], 0.51 - drift[2]], atol=1e-7
    )
