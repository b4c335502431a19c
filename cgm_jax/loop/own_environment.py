"""An environment of the user's own, as training uses it.

What training does not read may be of any type and change it from step to step; the scan over an
episode gets it in the form that `reset` gave it. Reward, done and metrics are mere outputs, and may
even change their shape. The environment may keep something for itself in info, in further entries
of the observation, and in pipeline_state; of those shapes must last, and types lose nothing.
"""

from typing import Any

import jax
import numpy as np
from flax import struct

from cgm_jax.config.fields import SettingError
from cgm_jax.config.user_code import user_code
from cgm_jax.loop.own_declarations import (
    MAX_ACTION_SIZE,
    MAX_EPISODE_LENGTH,
    distance_threshold_of,
    reward_range_of,
    stages_of,
    tolerance_of,
    whole_number,
)
from cgm_jax.loop.own_states import ENTRIES, WARNINGS, as_before, described, retyped, warnings_of


class OwnState(struct.PyTreeNode):
    """What the trainer carries and reads of an environment's state.

    Attributes:
        state: the environment's own, always of the structure, shapes and types of its `reset`.
        warnings: above 0 if its physics broke on the way to this state, float32 scalar.
    """

    state: Any
    warnings: jax.Array

    @property
    def obs(self) -> dict[str, Any]:
        """Observation, achieved and desired goal: arrays, or their shapes."""
        return {name: self.state.obs[name] for name in ENTRIES}

    @property
    def metrics(self) -> dict[str, jax.Array]:
        """Whether the physics held."""
        return {WARNINGS: self.warnings}


class OwnEnvironment:
    """A `GoalEnvironment` around one of the user's; make it by `checked`.

    Attributes:
        action_size, episode_length, distance_threshold: see `GoalEnvironment`.
        stages: see `StagedEnvironment`; empty where there are none.
        remarks: lines about what is allowed but hardly meant.
        compiles_physics: whether compiling it is a matter of minutes and of much memory.
        compiler_options, calls_physics: of this package's that may be inside, see environment.py.
    """

    def __init__(self, env: Any, name: str) -> None:
        self._env = env
        self.action_size = whole_number(env, name, "action_size", MAX_ACTION_SIZE)
        self.episode_length = whole_number(env, name, "episode_length", MAX_EPISODE_LENGTH)
        self.distance_threshold = distance_threshold_of(env, name)
        self.remarks: list[str] = []
        self.compiles_physics = False
        if hasattr(env, "restart"):  # optional in the protocol
            self.restart = self._restart
        self.stages = stages_of(env, name)
        if hasattr(env, "render_frame"):
            self.render_frame = self._render_frame
        self._name = name
        self._take_rules(env, name)
        self.compiler_options = getattr(env, "compiler_options", {})
        self.calls_physics = getattr(env, "calls_physics", False)

    def _take_rules(self, env: Any, name: str) -> None:
        """What the environment has of a `JudgingEnvironment`."""
        if hasattr(env, "goal_tolerance"):
            self.goal_tolerance = tolerance_of(env, name)
        if hasattr(env, "goal_success"):
            self.goal_success = env.goal_success
        if hasattr(env, "goal_reward"):
            self.reward_range = reward_range_of(env, name)
            self.goal_reward = env.goal_reward
        if hasattr(env, "is_terminal"):
            self.is_terminal = lambda state: env.is_terminal(state.state)

    def reset(self, rng: jax.Array) -> OwnState:
        """Start an episode."""
        state = self._env.reset(rng)
        return OwnState(jax.tree.map(retyped, state, state), warnings_of(state))

    def _restart(self, state: OwnState) -> OwnState:
        """Start an episode in a state that another one has visited."""
        after = self._env.restart(state.state)
        return OwnState(as_before(state.state, after), warnings_of(after))

    def _render_frame(self, state: Any, width: int, height: int) -> np.ndarray:
        """A frame of a state of the user's environment, concrete.

        Raises:
            SettingError: it fails, or is no frame of that size.
        """
        with user_code("video", f"render_frame of {self._name}"):
            frame = np.asarray(self._env.render_frame(state, width, height))
        if frame.shape != (height, width, 3) or frame.dtype != np.uint8:
            raise SettingError(
                f"video: render_frame of {self._name} returns {described(frame)}, "
                f"not uint8[{height},{width},3]"
            )
        return frame

    def step(self, state: OwnState, action: jax.Array) -> OwnState:
        """Advance by one control step."""
        after = self._env.step(state.state, action)
        return OwnState(as_before(state.state, after), warnings_of(after))
