"""The Fetch tasks as Gymnasium environments, with the conventions of Gymnasium-Robotics.

`import cgm_jax` registers them as cgm_jax/FetchReach-v0, cgm_jax/FetchPush-v0 and
cgm_jax/FetchPickAndPlace-v0. gymnasium_vector.py holds the batched version.
"""

# Brax types the parts of its State as unknown.
# pyright: reportAttributeAccessIssue=false, reportOptionalMemberAccess=false
# pyright: reportGeneralTypeIssues=false, reportArgumentType=false

import functools
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import gymnasium
import jax
import jax.numpy as jnp
import numpy as np
from brax.envs.base import State
from gymnasium import spaces

from cgm_jax.envs.fetch import FetchEnvironment
from cgm_jax.envs.make import make
from cgm_jax.envs.rendering import FRAMES_PER_SECOND, Renderer

METADATA: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": FRAMES_PER_SECOND}

GREATEST_OBSERVATION = 1000.0
"""Bound of the observation space: metres, radians, metres per control step. A robot's reach
and a falling block stay far below; what lies beyond is broken physics."""

Observation = dict[str, np.ndarray]
Information = Mapping[str, Any]


@dataclass(frozen=True)
class FetchPrograms:
    """One Fetch environment with its compiled functions.

    Attributes:
        env: the environment.
        reset: from a seed, a uint32 scalar, to a state.
        step: from a state and an action [4] to the next state.
        reset_many: the same for seeds [n].
        step_many: the same for n states and actions [n, 4].
        select: from a condition [n] and two batches of states to one, row by row.
    """

    env: FetchEnvironment
    reset: Callable[[np.uint32], State]
    step: Callable[[State, np.ndarray], State]
    reset_many: Callable[[np.ndarray], State]
    step_many: Callable[[State, np.ndarray], State]
    select: Callable[[np.ndarray, State, State], State]


@functools.cache
def fetch_programs(task: str, engine: str, **fields: float) -> FetchPrograms:
    """Make an environment and its programs, once per process and set of arguments.

    Each program compiles at its first call, for all instances together.

    Raises:
        ValueError: as `envs.make`.
    """
    env = make(task, engine, **fields)

    def reset(seed: jax.Array) -> State:
        return env.reset(jax.random.key(seed))

    def select(condition: jax.Array, yes: State, no: State) -> State:
        choose = jax.vmap(lambda chosen, x, y: jnp.where(chosen, x, y))
        return jax.tree.map(lambda x, y: choose(condition, x, y), yes, no)

    return FetchPrograms(
        env=env,
        reset=jax.jit(reset),
        step=jax.jit(env.step),
        reset_many=jax.jit(jax.vmap(reset)),
        step_many=jax.jit(jax.vmap(env.step)),
        select=jax.jit(select),
    )


def observation_space(env: FetchEnvironment) -> spaces.Dict:
    """The space of `env`'s observations, float64 as in Gymnasium-Robotics."""
    limit = GREATEST_OBSERVATION
    return spaces.Dict(
        {
            name: spaces.Box(-limit, limit, (size,), np.float64)
            for name, size in env.observation_size.items()
        }
    )


def action_space(env: FetchEnvironment) -> spaces.Box:
    """The space of `env`'s actions."""
    return spaces.Box(-1.0, 1.0, (env.action_size,), np.float32)


def observation_of(state: State) -> Observation:
    """The observation of a state or a batch of states."""
    return {name: np.asarray(value, np.float64) for name, value in state.obs.items()}


def draw_seed(generator: np.random.Generator) -> np.uint32:
    """A seed for `FetchPrograms.reset`, a uint32 scalar."""
    return generator.integers(2**32, dtype=np.uint32)


def is_achieved(
    achieved_goal: np.ndarray, desired_goal: np.ndarray, threshold: float
) -> np.ndarray | np.bool_:
    """Whether goals [..., 3] are achieved, [...]."""
    offset = np.asarray(achieved_goal) - np.asarray(desired_goal)
    return np.linalg.norm(offset, axis=-1) < threshold


def sparse_reward(
    achieved_goal: np.ndarray, desired_goal: np.ndarray, threshold: float
) -> np.ndarray | np.float64:
    """0 where goals [..., 3] are achieved, -1 elsewhere, [...] float64."""
    return np.where(is_achieved(achieved_goal, desired_goal, threshold), 0.0, -1.0)[()]


def make_renderer(env: FetchEnvironment, width: int, height: int) -> Renderer:
    """A renderer for `env`, which opens a drawing surface."""
    return Renderer(env.scene, env.distance_threshold, width, height)


def check_render_mode(mode: str | None) -> None:
    """Check a render mode.

    Raises:
        ValueError: it is neither None nor "rgb_array".
    """
    if mode not in (None, *METADATA["render_modes"]):
        raise ValueError(f"render_mode: {mode!r} is neither None nor 'rgb_array'")


class FetchGymnasium(gymnasium.Env[Observation, np.ndarray]):
    """One Fetch task as a goal-conditioned Gymnasium environment.

    Episodes do not terminate; Gymnasium's TimeLimit ends them after 50 steps. One whose physics
    breaks is truncated at once, with `info["physics_warnings"]` above 0.

    Attributes:
        state: the present state of the functional environment, None before the first reset.
            May be replaced, by one of `fetch.reset_to` for instance.
        fetch: the functional environment.
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
        """Make the environment; nothing compiles before the first reset.

        Args:
            task: "reach", "push" or "pick_and_place".
            engine: as for `envs.make`; `native` needs JAX on a CPU.
            render_mode: "rgb_array", or None to do without pictures.
            width: of the pictures, pixels.
            height: of the pictures, pixels.
            **fields: `air_probability`, `distance_threshold` in metres.

        Raises:
            ValueError: an argument out of its range.
        """
        check_render_mode(render_mode)
        self.render_mode = render_mode
        self._programs = fetch_programs(task, engine, **fields)
        self.fetch = self._programs.env
        self.observation_space = observation_space(self.fetch)
        self.action_space = action_space(self.fetch)
        self.state: State | None = None
        self._size, self._renderer = (width, height), None

    @property
    def distance_threshold(self) -> float:
        """A goal is achieved closer than this, metres."""
        return self.fetch.distance_threshold

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Start an episode; `seed` decides its start and goal and those of later episodes."""
        super().reset(seed=seed, options=options)
        self.state = self._programs.reset(draw_seed(self.np_random))
        return observation_of(self.state), {}

    def step(self, action: np.ndarray) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Advance by one control step of 0.04 s with `action` [4] in [-1, 1]."""
        self.state = self._programs.step(self.state, np.asarray(action, np.float32))
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
        return sparse_reward(achieved_goal, desired_goal, self.fetch.distance_threshold)

    def compute_terminated(
        self, achieved_goal: np.ndarray, desired_goal: np.ndarray, info: Information
    ) -> bool:
        """False: the task goes on after the goal is achieved."""
        return False

    def compute_truncated(
        self, achieved_goal: np.ndarray, desired_goal: np.ndarray, info: Information
    ) -> bool:
        """Whether the physics broke; the TimeLimit is the wrapper's."""
        return info.get("physics_warnings", 0) > 0

    def render(self) -> np.ndarray | None:  # pyright: ignore[reportIncompatibleMethodOverride]
        """A picture [height, width, 3] uint8, the goal green where it is achieved.

        Raises:
            RenderingError: this machine cannot render.
        """
        if self.render_mode is None:
            return None
        assert self.state is not None, "call reset before render"
        if self._renderer is None:
            self._renderer = make_renderer(self.fetch, *self._size)
        achieved, desired = (self.state.obs[name] for name in ("achieved_goal", "desired_goal"))
        return self._renderer.frame(
            self.fetch.physics.positions(self.state.pipeline_state),
            desired,
            achieved=bool(is_achieved(achieved, desired, self.fetch.distance_threshold)),
        )

    def close(self) -> None:
        """Free what rendering took."""
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None
