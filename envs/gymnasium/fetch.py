"""The Fetch tasks as Gymnasium environments, with the conventions of Gymnasium-Robotics.

`import cgm_jax` registers them as cgm_jax/FetchReach-v0, cgm_jax/FetchPush-v0 and
cgm_jax/FetchPickAndPlace-v0. vector.py holds the batched version.
"""

# mujoco's compiled modules come without stubs, Gymnasium's spaces are not those of its typing.
# pyright: reportAttributeAccessIssue=false

from typing import Any

import gymnasium
import jax
import mujoco
import numpy as np
from brax.envs.base import State
from gymnasium.error import ResetNeeded

from cgm_jax.envs.fetch import FetchEnvironment
from cgm_jax.envs.gymnasium.actions import checked_action
from cgm_jax.envs.gymnasium.arguments import METADATA, check_render_mode
from cgm_jax.envs.gymnasium.frames import Frames, warn_without_render_mode
from cgm_jax.envs.gymnasium.goals import physics_broke, reward_of
from cgm_jax.envs.gymnasium.mujoco_copy import MuJoCoCopy
from cgm_jax.envs.gymnasium.programs import draw_seed, fetch_programs
from cgm_jax.envs.gymnasium.resets import check_options
from cgm_jax.envs.gymnasium.spaces import (
    Observation,
    action_space,
    observation_of,
    observation_space,
)
from cgm_jax.envs.numpy_goals import is_achieved


class FetchGymnasium(gymnasium.Env[Observation, np.ndarray]):
    """One Fetch task as a goal-conditioned Gymnasium environment.

    Episodes do not terminate; Gymnasium's TimeLimit ends them after 50 steps. One whose physics
    breaks is truncated at once, with `info["physics_warnings"]` above 0.

    It can be copied, pickled and sent to other processes, at any point of an episode: the copy
    continues with the same states and random numbers. After `close` it may be used again.

    Attributes:
        state: the present state of the functional environment, None before the first reset.
            May be replaced, by one of `fetch.reset_to` for instance.
    """

    metadata = METADATA

    def __init__(
        self,
        task: str,
        *,
        engine: str = "native",
        render_mode: str | None = None,
        width: int = 640,
        height: int = 480,
        **fields: float,
    ) -> None:
        """Make the environment; nothing of JAX runs or compiles before the first reset.

        Args:
            task: "reach", "push" or "pick_and_place".
            engine: as for `envs.make`; `native` needs JAX on a CPU.
            render_mode: "rgb_array", or None to do without frames.
            width: of the frames, pixels.
            height: of the frames, pixels.
            **fields: `air_probability`, `distance_threshold` in metres.

        Raises:
            TypeError: an argument of another type.
            ValueError: an argument out of its range, or of no use.
        """
        check_render_mode(render_mode)
        self.render_mode = render_mode
        self._programs = fetch_programs(task, engine, **fields)
        self.observation_space = observation_space(self.fetch)
        self.action_space = action_space(self.fetch)
        self.state: State | None = None
        self._frames = Frames(self._programs, width, height)
        self._mujoco = MuJoCoCopy(self._programs)

    @property
    def distance_threshold(self) -> float:
        """A goal is achieved closer than this, metres."""
        return self.fetch.distance_threshold

    @property
    def fetch(self) -> FetchEnvironment:
        """The functional environment."""
        return self._programs.env

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Start an episode; `seed` decides its start and goal and those of later episodes.

        Raises:
            Error: a seed that is no integer, or below 0.
            RuntimeError: JAX would hang, since this process was forked after it had started.
            TypeError: options that are no dict.
            ValueError: any option, since none has an effect.
        """
        programs = self._programs.started()
        check_options(options)
        super().reset(seed=seed)
        self.state = programs.reset(draw_seed(self.np_random))
        self._mujoco.follow(self.state)
        return observation_of(self.state), {}

    def step(self, action: np.ndarray) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Advance by one control step of 0.04 s with `action` [4], clipped to [-1, 1].

        Raises:
            ResetNeeded: before the first reset.
            RuntimeError: as `reset`.
            ValueError: an action of another shape, or not finite.
        """
        programs, before = self._programs.started(), self._state_for("step")
        self.state = programs.step(before, checked_action(action, (self.fetch.action_size,)))
        self._mujoco.follow(self.state)
        observation = observation_of(self.state)
        achieved, desired = observation["achieved_goal"], observation["desired_goal"]
        info = {
            "is_success": bool(is_achieved(achieved, desired, self.fetch.distance_threshold)),
            "physics_warnings": int(self.state.metrics["physics_warnings"]),
        }
        return (
            observation,
            float(self.compute_reward(achieved, desired, info)),
            self.compute_terminated(achieved, desired, info),
            self.compute_truncated(achieved, desired, info),
            info,
        )

    def compute_reward(
        self, achieved_goal: np.ndarray, desired_goal: np.ndarray, info: Any
    ) -> np.ndarray | np.float64:
        """Reward of goals [3], or of a batch of them [..., 3]; `info` has no part in it."""
        return reward_of(achieved_goal, desired_goal, self.fetch.distance_threshold)

    def compute_terminated(
        self, achieved_goal: np.ndarray, desired_goal: np.ndarray, info: Any
    ) -> bool:
        """False: the task continues after the goal is achieved."""
        return False

    def compute_truncated(
        self, achieved_goal: np.ndarray, desired_goal: np.ndarray, info: Any
    ) -> bool:
        """Whether `info` tells of broken physics; the TimeLimit is the wrapper's."""
        return physics_broke(info)

    @property
    def model(self) -> mujoco.MjModel:
        """MuJoCo's model of the scene, a copy to be read."""
        return self._mujoco.model

    @property
    def data(self) -> mujoco.MjData:
        """MuJoCo's data of the present state, a copy to be read, which each step renews."""
        data = self._mujoco.data
        self._mujoco.follow(self.state)
        return data

    @property
    def initial_qpos(self) -> np.ndarray:
        """Generalised positions [nq] from which episodes start, but for the object's place."""
        return self.fetch.scene.home.astype(np.float32).astype(float)  # as the engines start

    @property
    def initial_qvel(self) -> np.ndarray:
        """Generalised velocities [nv] at the start of episodes: at rest."""
        return np.zeros(self.fetch.scene.model.nv)

    def render(self) -> np.ndarray | None:  # pyright: ignore[reportIncompatibleMethodOverride]
        """A frame [height, width, 3] uint8, the goal green where it is achieved.

        Raises:
            RenderingError: this machine cannot render.
            ResetNeeded: before the first reset.
        """
        if self.render_mode is None:
            warn_without_render_mode(self.spec.id if self.spec else type(self).__name__)
            return None
        state = jax.tree.map(lambda leaf: np.asarray(leaf)[None], self._state_for("render"))
        return next(self._frames.draw(state))

    def close(self) -> None:
        """Free what rendering took. Any number of times."""
        self._frames.close()

    def _state_for(self, purpose: str) -> State:
        if self.state is None:
            raise ResetNeeded(f"call reset before {purpose}")
        return self.state
