import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from mujoco import mjx

from cgm_jax.envs.physics.weld import WeldTerm

# pyright: reportAttributeAccessIssue=false

# Two hinges and a slide, welded off-centre and askew, next to a body that the weld does not move.
ARM = """
<mujoco>
  <compiler angle="radian"/>
  <worldbody>
    <body name="mocap" mocap="true" pos="0.5 0.1 0.2"/>
    <body><freejoint/><geom size="0.1"/></body>
    <body pos="0 0 0.1">
      <joint axis="0 0 1"/>
      <geom type="capsule" size="0.02" fromto="0 0 0 0.3 0 0"/>
      <body name="hand" pos="0.3 0 0">
        <joint axis="0 1 0"/>
        <joint type="slide" axis="1 0 0.5"/>
        <geom type="capsule" size="0.02" fromto="0 0 0 0.2 0 0"/>
      </body>
    </body>
  </worldbody>
  <equality>
    <weld body1="mocap" body2="hand" anchor="0.05 0.02 0" relpose="0.1 0 0 0.9 0.1 0.4 0.1"
          torquescale="0.7"/>
  </equality>
</mujoco>
"""


def reference_acceleration(
    model: mujoco.MjModel, data: mujoco.MjData, velocities: np.ndarray
) -> np.ndarray:
    data.qvel[:] = velocities
    mujoco.mj_forward(model, data)
    return data.efc_aref[:6].copy()


def test_the_term_is_the_one_of_c_mujoco() -> None:
    """C MuJoCo has aref = -b J v - k pos - Jdot v, of which only the last is even in v."""
    model = mujoco.MjModel.from_xml_string(ARM)
    data = mujoco.MjData(model)
    data.qpos[7:] = 0.4, -0.7, 0.05
    velocities = np.array([0.3, 0.1, -0.2, 1.0, 2.0, -1.0, 1.5, -2.0, 0.8])
    forwards, backwards, still = (
        reference_acceleration(model, data, sign * velocities) for sign in (1, -1, 0)
    )
    expected = still - (forwards + backwards) / 2
    assert np.abs(expected).min() > 0.05

    device_model, blank = mjx.put_model(model), mjx.make_data(model)

    @jax.jit
    def term(positions: jax.Array, velocities: jax.Array) -> jax.Array:
        state = blank.replace(qpos=positions, qvel=velocities)
        for stage in (mjx.kinematics, mjx.com_pos, mjx.com_vel):
            state = stage(device_model, state)
        return WeldTerm(model).value(state)

    found = term(jnp.asarray(data.qpos), jnp.asarray(velocities))
    np.testing.assert_allclose(found, expected, atol=1e-5)


def test_other_constraints_are_refused() -> None:
    joint = "<body><joint name='a'/><geom size='.1'/></body>"
    model = mujoco.MjModel.from_xml_string(
        f"<mujoco><worldbody>{joint}</worldbody><equality><joint joint1='a'/></equality></mujoco>"
    )
    with pytest.raises(ValueError, match="not a single weld"):
        WeldTerm(model)
