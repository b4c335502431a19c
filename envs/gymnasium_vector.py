"""Many Fetch environments as one Gymnasium vector environment: one batched call per step."""

# Brax types the parts of its State as unknown.
# pyright: reportAttributeAccessIssue=false, reportOptionalMemberAccess=false
# pyright: reportGeneralTypeIssues=false, reportArgumentType=false

from collections.abc import Sequence
from typing import Any

import numpy as np
from brax.envs.base import State
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from cgm_jax.envs.gymnasium_fetch import (
    METADATA,
    Observation,
    action_space,
    check_render_mode,
    draw_seed,
    fetch_programs,
    is_achieved,
    make_renderer,
    observation_of,
    observation_space,
    sparse_reward,
)

VECTOR_METADATA = {**METADATA, "autoreset_mode": AutoresetMode.NEXT_STEP}


class FetchVector(VectorEnv[Observation, np.ndarray, np.ndarray]):
    """A batch of one Fetch task; each row behaves as `FetchGymnasium` does alone.

    The step after a row's last one resets that row, whatever its action, with reward 0
    (Gymnasium's "next step" autoreset, the default of its own vector environments).

    Attributes:
        state: the present states of the functional environments, None before the first reset.
        fetch: the functional environment of one row.
    """

    metadata = VECTOR_METADATA

    def __init__(
        self,
        task: str,
        num_envs: int = 1,
        *,
        max_episode_steps: int = 50,
        engine: str = "native",
        render_mode: str | None = None,
        width: int = 640,
        height: int = 480,
        **fields: float,
    ) -> None:
        """Make the environments; nothing compiles before the first reset.

        Args:
            task: "reach", "push" or "pick_and_place".
            num_envs: how many rows, n.
            max_episode_steps: steps per episode.
            engine: as for `envs.make`; `native` needs JAX on a CPU.
            render_mode: "rgb_array", or None to do without pictures.
            width: of the pictures, pixels.
            height: of the pictures, pixels.
            **fields: `air_probability`, `distance_threshold` in metres.

        Raises:
            ValueError: an argument out of its range.
        """
        check_render_mode(render_mode)
        if num_envs < 1:
            raise ValueError(f"num_envs: {num_envs} is not at least 1")
        self.num_envs, self.render_mode = num_envs, render_mode
        self._programs = fetch_programs(task, engine, **fields)
        self.fetch = self._programs.env
        self.single_observation_space = observation_space(self.fetch)
        self.single_action_space = action_space(self.fetch)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.state: State | None = None
        self._max_episode_steps = max_episode_steps
        self._generators: list[np.random.Generator] | None = None
        self._elapsed = np.zeros(num_envs, int)
        self._ended = np.zeros(num_envs, bool)
        self._size, self._renderer = (width, height), None

    @property
    def distance_threshold(self) -> float:
        """A goal is achieved closer than this, metres."""
        return self.fetch.distance_threshold

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[Observation, dict[str, Any]]:
        """Start an episode in every row.

        Args:
            seed: of the first row, the others counting on from there; or one for each row.
                None goes on with the random numbers that the rows have.
            options: without effect.

        Raises:
            ValueError: as many seeds as rows were expected.
        """
        self._seed(seed)
        everywhere = np.ones(self.num_envs, bool)
        self.state = self._programs.reset_many(self._draw_seeds(everywhere))
        self._elapsed[:], self._ended[:] = 0, False
        return observation_of(self.state), {}

    def step(
        self, actions: np.ndarray
    ) -> tuple[Observation, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Advance rows by one control step with `actions` [n, 4]; reset those that have ended."""
        assert self.state is not None, "call reset before step"
        restarted = self._ended
        self.state = self._advance(np.asarray(actions, np.float32), restarted)
        observation = observation_of(self.state)
        achieved, desired = observation["achieved_goal"], observation["desired_goal"]
        warnings = np.asarray(self.state.metrics["physics_warnings"]).astype(int)
        self._elapsed = np.where(restarted, 0, self._elapsed + 1)
        self._ended = (self._elapsed >= self._max_episode_steps) | (warnings > 0)
        success = is_achieved(achieved, desired, self.fetch.distance_threshold)
        information = {
            "is_success": success & ~restarted,
            "_is_success": ~restarted,
            "physics_warnings": warnings,
            "_physics_warnings": ~restarted,
        }
        reward = np.where(restarted, 0.0, self.compute_reward(achieved, desired, {}))
        terminated = np.zeros(self.num_envs, bool)
        return observation, reward, terminated, self._ended.copy(), information

    def compute_reward(
        self, achieved_goal: np.ndarray, desired_goal: np.ndarray, info: Any
    ) -> np.ndarray | np.float64:
        """Reward of goals [3], or of a batch of them [..., 3]; `info` has no part in it."""
        return sparse_reward(achieved_goal, desired_goal, self.fetch.distance_threshold)

    def render(self) -> tuple[np.ndarray, ...] | None:  # pyright: ignore[reportIncompatibleMethodOverride]
        """A picture [height, width, 3] uint8 of each row.

        Raises:
            RenderingError: this machine cannot render.
        """
        if self.render_mode is None:
            return None
        assert self.state is not None, "call reset before render"
        if self._renderer is None:
            self._renderer = make_renderer(self.fetch, *self._size)
        renderer, observation = self._renderer, observation_of(self.state)
        desired = observation["desired_goal"]
        achieved = is_achieved(observation["achieved_goal"], desired, self.fetch.distance_threshold)
        rows = self.fetch.physics.positions(self.state.pipeline_state)
        return tuple(
            renderer.frame(row, goal, achieved=bool(reached))
            for row, goal, reached in zip(rows, desired, np.atleast_1d(achieved), strict=True)
        )

    def close_extras(self, **_: Any) -> None:
        """Free what rendering took."""
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None

    def _advance(self, actions: np.ndarray, restarted: np.ndarray) -> State:
        if not restarted.any():
            return self._programs.step_many(self.state, actions)
        fresh = self._programs.reset_many(self._draw_seeds(restarted))
        if restarted.all():
            return fresh
        return self._programs.select(
            restarted, fresh, self._programs.step_many(self.state, actions)
        )

    def _seed(self, seed: int | Sequence[int | None] | None) -> None:
        if isinstance(seed, int):
            seed = [seed + i for i in range(self.num_envs)]
        seeds = [None] * self.num_envs if seed is None else list(seed)
        if len(seeds) != self.num_envs:
            raise ValueError(f"seed: {len(seeds)} seeds for {self.num_envs} environments")
        before = self._generators or [seeding.np_random()[0] for _ in seeds]
        self._generators = [
            old if one is None else seeding.np_random(one)[0]
            for old, one in zip(before, seeds, strict=True)
        ]

    def _draw_seeds(self, rows: np.ndarray) -> np.ndarray:
        """Seeds [n]; only the generators of `rows` [n] move on."""
        assert self._generators is not None
        return np.array(
            [
                draw_seed(generator) if row else np.uint32(0)
                for generator, row in zip(self._generators, rows, strict=True)
            ]
        )
