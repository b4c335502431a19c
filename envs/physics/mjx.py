"""MJX: MuJoCo as a JAX program (GPU, TPU, CPU), or through Warp on an NVIDIA GPU."""

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
from cgm_jax.envs.physics.protocol import PhysicsState
from cgm_jax.envs.physics.weld import WeldTerm
from cgm_jax.envs.scene import Scene

# XLA's fusion emitters on CPU take minutes to compile the vmapped kinematics of an arm and
# then run it a hundred times slower. The flag costs network updates 7 %, so only this engine
# sets it. It has no meaning on a GPU, and no effect once anything has run on JAX's backend: make
# the environment first, or set XLA_FLAGS yourself.
CPU_FLAG = "--xla_cpu_use_fusion_emitters=false"


# What sensors of position and velocity need, without the cost of collision and dynamics.
SENSOR_STAGES = (mjx.kinematics, mjx.com_pos, mjx.com_vel, mjx.sensor_pos, mjx.sensor_vel)


class Motion(struct.PyTreeNode):
    """What MJX carries from step to step; everything else in its Data follows from it."""

    positions: jax.Array
    velocities: jax.Array
    acceleration_guess: jax.Array


class MjxPhysics:
    """The `mjx` and `warp` engines. See `envs.physics.protocol.Physics`."""

    def __init__(self, scene: Scene, implementation: str = "jax") -> None:
        """Put the scene's model on the device.

        Args:
            scene: what to simulate.
            implementation: "jax", or "warp" where warp-lang is installed.
        """
        flags = os.environ.get("XLA_FLAGS", "")
        if CPU_FLAG.partition("=")[0] not in flags:
            os.environ["XLA_FLAGS"] = f"{flags} {CPU_FLAG}".strip()
        self._blocked = jnp.asarray(scene.blocked_addresses, jnp.int32)
        self._substeps = scene.substeps
        self._model = mjx.put_model(scene.model, impl=implementation)
        self._template = mjx.make_data(scene.model, impl=implementation)
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
        data.qpos[:] = np.asarray(motion.positions)
        data.qvel[:] = np.asarray(motion.velocities)
        data.qacc_warmstart[:] = np.asarray(motion.acceleration_guess)

    def _step(self, data: mjx.Data) -> mjx.Data:
        """One substep: `mjx.step`, without sensors and with the weld's missing term."""
        if self._model.impl == mjx.Impl.WARP:
            return mjx.step(self._model, data)
        data = mjx.fwd_velocity(self._model, mjx.fwd_position(self._model, data))
        data = self._weld_term.add(data)
        for stage in (mjx.fwd_actuation, mjx.fwd_acceleration, mjx.solve, mjx.euler):
            data = stage(self._model, data)
        return data

    def _observe(self, data: mjx.Data) -> PhysicsState:
        """Bring the sensors up to the state: a step leaves them one substep behind."""
        if self._model.impl == mjx.Impl.WARP:
            data = mjx.forward(self._model, data)
        else:
            for stage in SENSOR_STAGES:
                data = stage(self._model, data)
        # The limit at which C MuJoCo warns; NaN is not below it either.
        within = [(jnp.abs(x) < mujoco.mjMAXVAL).all() for x in (data.qpos, data.qvel)]
        return PhysicsState(
            engine_state=Motion(data.qpos, data.qvel, data.qacc_warmstart),
            sensors=data.sensordata,
            warnings=jnp.where(jnp.stack(within).all(), 0, 1).astype(jnp.int32),
        )
