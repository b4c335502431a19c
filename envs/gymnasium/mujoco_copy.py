"""The simulation as MuJoCo's own model and data, for code written against Gymnasium-Robotics."""

# mujoco's compiled modules come without stubs; Brax types the parts of its State as unknown.
# pyright: reportAttributeAccessIssue=false, reportArgumentType=false

import copy
import functools
from typing import Any

import mujoco
from brax.envs.base import State

from cgm_jax.envs.gymnasium.programs import FetchPrograms


class MuJoCoCopy:
    """A model and data of its own that follow an environment's state.

    They are there to be read: the simulation itself does not see what is written into them. Made
    at the first access; until then following costs nothing.
    """

    def __init__(self, programs: FetchPrograms) -> None:
        """Note what to follow."""
        self._programs = programs
        self._shown: State | None = None

    @functools.cached_property
    def model(self) -> mujoco.MjModel:
        """The model."""
        return copy.deepcopy(self._programs.env.scene.model)

    @functools.cached_property
    def data(self) -> mujoco.MjData:
        """The data, current with the last state that was followed; first the initial pose."""
        data = mujoco.MjData(self.model)
        data.qpos[:] = self._programs.env.scene.home
        mujoco.mj_forward(self.model, data)
        return data

    def follow(self, state: State | None) -> None:
        """Bring the data up to `state`, where they have been asked for."""
        if "data" not in self.__dict__ or state is None or state is self._shown:
            return
        physics = self._programs.env.physics
        physics.copy_to_mujoco(state.pipeline_state, self.data)
        mujoco.mj_forward(self.model, self.data)
        self._shown = state

    def __reduce__(self) -> tuple[Any, ...]:
        return MuJoCoCopy, (self._programs,)
