"""C MuJoCo from inside a jitted scan: one `mujoco.batch.Batch` call for all simulations.

JAX sees a pure function. The state of a simulation is its float64 state row, which travels
through JAX as raw bits (uint32), so that no rounding happens between control steps. Under
vmap, to any depth, the leading axes are broadcast and flattened: all environments of a run, or of
all runs that are vmapped, land in one call, which MuJoCo spreads over its thread pool,
bit-identical at any number of threads.

`buffer_callback` hands numpy views of XLA's own buffers to Python; `pure_callback` copies
them through JAX arrays, which costs about ten times as much per call.
"""

# mujoco's compiled modules come without stubs.
# pyright: reportAttributeAccessIssue=false

import contextlib
from collections.abc import Iterator
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from jax.experimental.buffer_callback import buffer_callback
from mujoco.batch import Batch

from cgm_jax.envs.mocap_controller import ControlTarget
from cgm_jax.envs.physics.choose import COMPILER_OPTIONS
from cgm_jax.envs.physics.protocol import PhysicsState
from cgm_jax.envs.scene import Scene
from cgm_jax.machine.allotment import cores_each

WORDS_PER_FLOAT64 = 2
TIME_SIZE = 1  # a state row starts with the time; the positions follow
STATE_ROW = int(mujoco.mjtState.mjSTATE_INTEGRATION.value)  # what a state row holds
COUNT = 1  # Batch.warning holds, per simulation and kind, what it was last about, and a count
# Current positions and velocities suffice for every sensor, and accelerations would cost a
# constraint solve.
SENSOR_STAGE = int(mujoco.mjtStage.mjSTAGE_VEL.value)


class NativePhysics:
    """The `native` engine. See `envs.physics.protocol.Physics`."""

    is_compiled = False
    compiler_options = COMPILER_OPTIONS["native"]

    def __init__(self, scene: Scene, threads: int | None = None) -> None:
        """Prepare to simulate `scene` on `threads` threads per caller.

        By default devices that compute at the same time share the cores that this process may
        use. Any number of threads gives the same bits.
        """
        self._model = scene.model
        self._blocked = list(scene.blocked_addresses)
        self._substeps = scene.substeps
        self._threads = threads or cores_each()
        # Devices call at the same time, and a Batch serves one caller at a time.
        self._idle: dict[int, list[Batch]] = {}
        self._row_words = WORDS_PER_FLOAT64 * mujoco.mj_stateSize(self._model, STATE_ROW)

    def start(self, positions: jax.Array) -> PhysicsState:
        """A simulation at rest at the generalised positions [nq]."""
        return self._call(self._start, positions)

    def advance(self, state: PhysicsState, target: ControlTarget) -> PhysicsState:
        """Pursue the target for one control step (0.04 s)."""
        command = jnp.concatenate(target)
        return self._call(self._advance, state.engine_state, command)

    def positions(self, state: PhysicsState) -> np.ndarray:
        """Generalised positions [..., nq], float64, of concrete states."""
        rows = np.asarray(state.engine_state).view(np.float64)
        return rows[..., TIME_SIZE : TIME_SIZE + self._model.nq]

    def copy_to_mujoco(self, state: PhysicsState, data: mujoco.MjData) -> None:
        """Put one concrete state into MuJoCo's own data, every bit of it."""
        row = np.asarray(state.engine_state).view(np.float64)
        mujoco.mj_setState(self._model, data, row, STATE_ROW)

    def _call(self, function: Any, *arguments: jax.Array) -> PhysicsState:
        """Run a host function on the buffers of all vmapped simulations at once."""
        outputs = (
            jax.ShapeDtypeStruct((self._row_words,), jnp.uint32),
            jax.ShapeDtypeStruct((self._model.nsensordata,), jnp.float32),
            jax.ShapeDtypeStruct((), jnp.int32),
        )
        call = buffer_callback(function, outputs, vmap_method="broadcast_all")
        return PhysicsState(*call(*arguments))

    def _start(self, _: Any, outputs: Any, positions: Any) -> None:
        """Host side of `start`: every simulation at rest at its positions."""
        positions = _rows(positions)
        with self._batch(len(positions)) as batch:
            batch.reset(stage=mujoco.mjtStage.mjSTAGE_NONE.value)
            batch.bind("qpos")[:] = positions
            batch.forward(stage=SENSOR_STAGE)
            self._copy_out(batch, outputs)

    def _advance(self, _: Any, outputs: Any, state: Any, command: Any) -> None:
        """Host side of `advance`: load the rows, set the commands, step, hand the rows back."""
        rows, command = _rows(state), _rows(command)
        with self._batch(len(rows)) as batch:
            batch.state[:] = rows.view(np.float64)
            batch.bind("qpos")[:, self._blocked] = 0.0
            batch.bind("mocap_pos")[:, 0] = command[:, :3]
            batch.bind("mocap_quat")[:, 0] = command[:, 3:7]
            batch.bind("ctrl")[:] = command[:, 7:]
            batch.step(nstep=self._substeps, stage=SENSOR_STAGE)
            self._copy_out(batch, outputs)

    def _copy_out(self, batch: Batch, outputs: Any) -> None:
        state, sensors, warnings = (np.asarray(output) for output in outputs)
        _rows(state).view(np.float64)[:] = batch.state
        _rows(sensors)[:] = batch.bind("sensordata")
        # Batch resets a simulation whose state turns NaN and says so only here.
        warnings.reshape(-1)[:] = batch.warning[:, :, COUNT].sum(axis=-1)
        batch.warning[:] = 0

    @contextlib.contextmanager
    def _batch(self, simulations: int) -> Iterator[Batch]:
        """A batch of that size which nobody uses; training and evaluation each reuse their own."""
        idle = self._idle.setdefault(simulations, [])
        try:
            batch = idle.pop()
        except IndexError:
            batch = Batch(self._model, simulations, self._threads)
            batch.bind("sensordata")
        yield batch
        idle.append(batch)


def _rows(buffer: Any) -> np.ndarray:
    """All leading axes of a host buffer as one; a view, never a copy."""
    array = np.asarray(buffer)
    return array.reshape(-1, array.shape[-1])
