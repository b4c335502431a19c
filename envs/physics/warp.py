"""MuJoCo Warp through MJX: MuJoCo as kernels for an NVIDIA GPU; on a CPU for tests.

Warp keeps the contacts of all simulations in one array and silently drops what does not fit. So
the array is sized by the number of simulations, which only vmap knows: `start` and `advance` have
a rule of their own for it, and see all runs and environments as the rows of one batch.
"""

# mujoco's compiled modules come without stubs.
# pyright: reportAttributeAccessIssue=false

import contextlib
import os
import sys
from collections.abc import Callable, Iterator
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import warp  # pyright: ignore[reportMissingImports] -- an extra
from mujoco import mjx
from mujoco.mjx.third_party.mujoco_warp._src.types import OverflowType

from cgm_jax.envs.mocap_controller import ControlTarget
from cgm_jax.envs.physics.choose import COMPILER_OPTIONS
from cgm_jax.envs.physics.mjx import Motion, out_of_range
from cgm_jax.envs.physics.protocol import PhysicsState
from cgm_jax.envs.scene import Scene

CONTACTS_PER_PAIR = 8
"""The most that two boxes, or a box and a plane, ever have."""

REMARKS = int(OverflowType.ITERATIONS | OverflowType.LS_ITERATIONS)
"""A solver that has used up its iterations has lost nothing; C MuJoCo does not mention it."""


class WarpPhysics:
    """The `warp` engine. See `envs.physics.protocol.Physics`."""

    is_compiled = True
    compiler_options = COMPILER_OPTIONS["warp"]

    def __init__(
        self, scene: Scene, contacts: int | None = None, constraints: int | None = None
    ) -> None:
        """Put the scene's model on the device.

        Args:
            scene: what to simulate.
            contacts: room for contacts, per simulation; all simulations share it. Default: for
                whatever can touch.
            constraints: room for rows of constraints of each simulation; default likewise.
        """
        _begin_warp()
        sizes = most_contacts_and_constraints(scene.model)
        self._contacts = contacts or sizes[0]
        self._blocked = jnp.asarray(scene.blocked_addresses, jnp.int32)
        self._substeps = scene.substeps
        model = mjx.put_model(scene.model, impl="warp")
        self._model = model.tree_replace({"opt._impl.warn_overflow": 0})  # it would print
        self._one_contact = mjx.make_data(
            scene.model, impl="warp", naconmax=1, njmax=constraints or sizes[1]
        )
        self._start = _for_one(self._start_rows)
        self._advance = _for_one(self._advance_rows)

    def start(self, positions: jax.Array) -> PhysicsState:
        """A simulation at rest at the generalised positions [nq]."""
        return self._start(positions)

    def advance(self, state: PhysicsState, target: ControlTarget) -> PhysicsState:
        """Pursue the target for one control step (0.04 s)."""
        return self._advance(state.engine_state, target)

    def positions(self, state: PhysicsState) -> np.ndarray:
        """Generalised positions [..., nq] of concrete states."""
        motion: Motion = state.engine_state
        return np.asarray(motion.positions)

    def copy_to_mujoco(self, state: PhysicsState, data: mujoco.MjData) -> None:
        """Put one concrete state into MuJoCo's own data: positions and velocities."""
        motion: Motion = state.engine_state
        motion.copy_to_mujoco(data)

    def _start_rows(self, positions: jax.Array) -> PhysicsState:
        """Simulations [N] at rest at positions [N, nq]."""
        data = self._data(len(positions))
        return jax.vmap(lambda qpos: self._observe(data.replace(qpos=qpos)))(positions)

    def _advance_rows(self, motion: Motion, target: ControlTarget) -> PhysicsState:
        """A control step of simulations [N]."""
        data = self._data(len(motion.positions))

        def advance(motion: Motion, target: ControlTarget) -> PhysicsState:
            one = data.replace(
                qpos=motion.positions.at[self._blocked].set(0.0),
                qvel=motion.velocities,
                qacc_warmstart=motion.acceleration_guess,
                mocap_pos=target.mocap_position[None],
                mocap_quat=target.mocap_orientation[None],
                ctrl=target.finger_command,
            )
            one, _ = jax.lax.scan(
                lambda one, _: (mjx.step(self._model, one), None), one, length=self._substeps
            )
            return self._observe(one)

        return jax.vmap(advance)(motion, target)

    def _data(self, simulations: int) -> mjx.Data:
        """Data of one simulation with room for the contacts of so many."""
        room = simulations * self._contacts
        impl: Any = self._one_contact._impl
        fields = {
            f"_impl.{name}": jnp.broadcast_to(rows, (room, *rows.shape[1:]))
            for name, rows in vars(impl).items()
            if name.startswith("contact__") and len(rows)
        }
        sizes = {"_impl.naconmax": room, "_impl.naccdmax": room}
        return self._one_contact.tree_replace({**fields, **sizes})  # pyright: ignore[reportReturnType]

    def _observe(self, data: mjx.Data) -> PhysicsState:
        """Bring the sensors up to the state: a step leaves them one substep behind."""
        impl: Any = data._impl
        overflow = impl.overflow & ~REMARKS
        data = mjx.forward(self._model, data)
        broken = out_of_range(data.qpos, data.qvel) | (overflow != 0)
        return PhysicsState(
            engine_state=Motion(data.qpos, data.qvel, data.qacc_warmstart),
            sensors=data.sensordata,
            warnings=broken.astype(jnp.int32),
        )


def most_contacts_and_constraints(model: mujoco.MjModel) -> tuple[int, int]:
    """How many contacts, and rows of constraints, a simulation of a model can ever have.

    Raises:
        ValueError: geoms touch that no pair of the model names, so that nothing bounds them.
    """
    if model.geom_contype.any() or model.geom_conaffinity.any():
        raise ValueError("scene: engine warp needs contacts that are all named as pairs")
    pyramid = np.maximum(2 * (model.pair_dim - 1), 1)
    welds = 6 * int(np.sum(model.eq_type == mujoco.mjtEq.mjEQ_WELD))
    friction = int(np.sum(model.dof_frictionloss > 0))
    limits = 2 * int(np.sum(model.jnt_limited)) + 2 * int(np.sum(model.tendon_limited))
    rows = welds + friction + limits + CONTACTS_PER_PAIR * int(pyramid.sum())
    return CONTACTS_PER_PAIR * model.npair, rows


def _begin_warp() -> None:
    """Start Warp without its banner, its line per kernel, and its regret that there is no GPU."""
    warp.config.log_level = warp.LOG_ERROR
    with _silenced_below() if jax.default_backend() == "cpu" else contextlib.nullcontext():
        warp.init()


@contextlib.contextmanager
def _silenced_below() -> Iterator[None]:
    """Drop what libraries that are not Python write to standard error meanwhile."""
    sys.stderr.flush()
    kept, nowhere = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 2)
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(nowhere)


def _for_one(rows_function: Callable[..., Any]) -> Callable[..., Any]:
    """From a function of N rows one of a single row that under vmaps, to any depth, sees all."""
    rows = jax.custom_batching.custom_vmap(rows_function)

    @rows.def_vmap
    def _(axis_size: int, batched: Any, *arguments: Any) -> tuple[Any, Any]:
        spread = jax.tree.map(
            lambda x, is_batched: x if is_batched else jnp.broadcast_to(x, (axis_size, *x.shape)),
            arguments,
            tuple(batched),
        )
        flat = jax.tree.map(lambda x: x.reshape(-1, *x.shape[2:]), spread)
        out = jax.tree.map(lambda x: x.reshape(axis_size, -1, *x.shape[1:]), rows(*flat))
        return out, jax.tree.map(lambda _: True, out)

    def one(*arguments: Any) -> Any:
        out = rows(*jax.tree.map(lambda x: x[None], arguments))
        return jax.tree.map(lambda x: x[0], out)

    return one
