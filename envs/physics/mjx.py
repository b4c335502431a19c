"""MJX: MuJoCo as a JAX program (GPU, TPU, CPU)."""

# mujoco's compiled modules come without stubs.
# pyright: reportAttributeAccessIssue=false

import os

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from flax import struct
from mujoco import mjx

from cgm_jax.envs.mocap_controller import ControlTarget
from cgm_jax.envs.physics.choose import COMPILER_OPTIONS
from cgm_jax.envs.physics.protocol import PhysicsState
from cgm_jax.envs.physics.weld import WeldTerm
from cgm_jax.envs.scene import Scene

# For programs that do not ask for `compiler_options`, such as another library's. It has no effect
# once anything has run on JAX's backend: make the environment first, or set XLA_FLAGS yourself.
CPU_FLAG = "--xla_cpu_use_fusion_emitters=false"


# What sensors of position and velocity need, without the cost of collision and dynamics.
SENSOR_STAGES = (mjx.kinematics, mjx.com_pos, mjx.com_vel, mjx.sensor_pos, mjx.sensor_vel)


class Motion(struct.PyTreeNode):
    """What MJX carries from step to step; everything else in its Data follows from it."""

    positions: jax.Array
    velocities: jax.Array
    acceleration_guess: jax.Array

    def copy_to_mujoco(self, data: mujoco.MjData) -> None:
        """Put one concrete motion into MuJoCo's own data."""
        data.qpos[:] = np.asarray(self.positions)
        data.qvel[:] = np.asarray(self.velocities)
        data.qacc_warmstart[:] = np.asarray(self.acceleration_guess)


def out_of_range(positions: jax.Array, velocities: jax.Array) -> jax.Array:
    """Whether a motion is beyond the limit at which C MuJoCo warns; NaN is, too."""
    within = [(jnp.abs(x) < mujoco.mjMAXVAL).all() for x in (positions, velocities)]
    return ~jnp.stack(within).all()


class MjxPhysics:
    """The `mjx` engine. See `envs.physics.protocol.Physics`."""

    is_compiled = True
    compiler_options = COMPILER_OPTIONS["mjx"]

    def __init__(self, scene: Scene) -> None:
        """Put the scene's model on the device."""
        flags = os.environ.get("XLA_FLAGS", "")
        if CPU_FLAG.partition("=")[0] not in flags:
            os.environ["XLA_FLAGS"] = f"{flags} {CPU_FLAG}".strip()
        self._blocked = jnp.asarray(scene.blocked_addresses, jnp.int32)
        self._substeps = scene.substeps
        self._model = mjx.put_model(scene.model, impl="jax")
        self._template = mjx.make_data(scene.model, impl="jax")
        self._weld_term = WeldTerm(scene.model)

    def start(self, positions: jax.Array) -> PhysicsState:
        """A simulation at rest at the generalised positions [nq]."""
        data = self._template.replace(qpos=positions)
        return self._observe(data)

    def advance(self, state: PhysicsState, target: ControlTarget) -> PhysicsState:
        """Pursue the target for one control step (0.04 s)."""
        motion: Motion = state.engine_state
        data = self._template.replace(
            qpos=motion.positions.at[self._blocked].set(0.0),
            qvel=motion.velocities,
            qacc_warmstart=motion.acceleration_guess,
            mocap_pos=target.mocap_position[None],
            mocap_quat=target.mocap_orientation[None],
            ctrl=target.finger_command,
        )
        data, _ = jax.lax.scan(
            lambda data, _: (self._step(data), None), data, length=self._substeps
        )
        return self._observe(data)

    def positions(self, state: PhysicsState) -> np.ndarray:
        """Generalised positions [..., nq] of concrete states."""
        motion: Motion = state.engine_state
        return np.asarray(motion.positions)

    def copy_to_mujoco(self, state: PhysicsState, data: mujoco.MjData) -> None:
        """Put one concrete state into MuJoCo's own data: positions and velocities."""
        motion: Motion = state.engine_state
        motion.copy_to_mujoco(data)

    def _step(self, data: mjx.Data) -> mjx.Data:
        """One substep: `mjx.step`, without sensors and with the weld's missing term."""
        data = mjx.fwd_velocity(self._model, mjx.fwd_position(self._model, data))
        data = self._weld_term.add(data)
        for stage in (mjx.fwd_actuation, mjx.fwd_acceleration, mjx.solve, mjx.euler):
            data = stage(self._model, data)
        return data

    def _observe(self, data: mjx.Data) -> PhysicsState:
        """Bring the sensors up to the state: a step leaves them one substep behind."""
        for stage in SENSOR_STAGES:
            data = stage(self._model, data)
        return PhysicsState(
            engine_state=Motion(data.qpos, data.qvel, data.qacc_warmstart),
            sensors=data.sensordata,
            warnings=out_of_range(data.qpos, data.qvel).astype(jnp.int32),
        )
