"""An engine that starts when it is first used.

Starting an engine starts JAX, and a process that is forked after that hangs in its first
computation. So whoever makes environments that may yet be sent to other processes defers it.
"""

# mujoco's compiled modules come without stubs.
# pyright: reportAttributeAccessIssue=false

import functools
from collections.abc import Mapping

import jax
import mujoco
import numpy as np

from cgm_jax.envs.mocap_controller import ControlTarget
from cgm_jax.envs.physics.choose import COMPILER_OPTIONS, check_engine, start_engine
from cgm_jax.envs.physics.protocol import Physics, PhysicsState
from cgm_jax.envs.scene import Scene


class DeferredPhysics:
    """Any engine, started at its first use. See `envs.physics.protocol.Physics`."""

    def __init__(self, name: str, scene: Scene) -> None:
        """Note which engine is to simulate `scene`; nothing of JAX runs.

        Raises:
            ValueError: the engine is unknown or not installed.
        """
        check_engine(name)
        self._name, self._scene = name, scene

    def begin(self) -> None:
        """Start the engine, unless it has been. To be called before anything is traced.

        Raises:
            ValueError: it cannot run on JAX's device.
        """
        _ = self._engine

    @property
    def is_compiled(self) -> bool:
        """Whether XLA compiles the engine."""
        return self._engine.is_compiled

    @property
    def compiler_options(self) -> Mapping[str, bool]:
        """XLA's options for programs that have the engine in them."""
        return COMPILER_OPTIONS[self._name]

    @functools.cached_property
    def _engine(self) -> Physics:
        return start_engine(self._name, self._scene)

    def start(self, positions: jax.Array) -> PhysicsState:
        """A simulation at rest at the generalised positions [nq]."""
        return self._engine.start(positions)

    def advance(self, state: PhysicsState, target: ControlTarget) -> PhysicsState:
        """Pursue the target for one control step (0.04 s)."""
        return self._engine.advance(state, target)

    def positions(self, state: PhysicsState) -> np.ndarray:
        """Generalised positions [..., nq] of concrete states."""
        return self._engine.positions(state)

    def copy_to_mujoco(self, state: PhysicsState, data: mujoco.MjData) -> None:
        """Put one concrete state into MuJoCo's own data."""
        self._engine.copy_to_mujoco(state, data)
