"""What a physics engine offers to an environment."""

# mujoco's compiled modules come without stubs.
# pyright: reportAttributeAccessIssue=false

from collections.abc import Mapping
from typing import Any, Protocol

import jax
import mujoco
import numpy as np
from flax import struct

from cgm_jax.envs.mocap_controller import ControlTarget


class PhysicsState(struct.PyTreeNode):
    """State of one simulation, a pytree that can be scanned, vmapped and stored.

    Attributes:
        engine_state: whatever the engine needs to resume exactly where it was.
        sensors: sensor data [nsensordata], current with the state.
        warnings: number of physics warnings in the last advance (bad state, divergence), an
            int32 scalar. Above 0 the state is not to be trusted.
    """

    engine_state: Any
    sensors: jax.Array
    warnings: jax.Array


class Physics(Protocol):
    """A physics engine: pure functions of one simulation, vmappable to any depth.

    Attributes:
        is_compiled: whether its steps are part of the programs that XLA compiles.
    """

    @property
    def is_compiled(self) -> bool:
        """Whether XLA compiles it."""
        ...

    @property
    def compiler_options(self) -> Mapping[str, bool]:
        """XLA's options for programs that have the engine in them, as `jax.jit` takes them."""
        ...

    def start(self, positions: jax.Array) -> PhysicsState:
        """A simulation at rest at the generalised positions [nq]."""
        ...

    def advance(self, state: PhysicsState, target: ControlTarget) -> PhysicsState:
        """Pursue the target for one control step (0.04 s)."""
        ...

    def positions(self, state: PhysicsState) -> np.ndarray:
        """Generalised positions [..., nq] of concrete states with leading axes [...].

        On the host and outside of any traced function, for renderers and analysis.
        """
        ...

    def copy_to_mujoco(self, state: PhysicsState, data: mujoco.MjData) -> None:
        """Put one concrete state into `data`, which belongs to the scene's model or a copy of it.

        What follows from the state there, such as positions of bodies, is for `mj_forward`.
        """
        ...
