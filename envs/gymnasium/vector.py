"""Many Fetch environments as one Gymnasium vector environment: one batched call per step."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from brax.envs.base import State
from gymnasium.error import ClosedEnvironmentError, ResetNeeded
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from cgm_jax.envs.fetch import FetchEnvironment
from cgm_jax.envs.gymnasium.actions import checked_action
from cgm_jax.envs.gymnasium.arguments import METADATA, check_render_mode, row_count, step_limit
from cgm_jax.envs.gymnasium.frames import Frames, warn_without_render_mode
from cgm_jax.envs.gymnasium.goals import reward_of
from cgm_jax.envs.gymnasium.programs import FetchPrograms, draw_seed, fetch_programs
from cgm_jax.envs.gymnasium.resets import row_seeds, rows_to_reset
from cgm_jax.envs.gymnasium.spaces import (
    Observation,
    action_space,
    observation_of,
    observation_space,
)
from cgm_jax.envs.numpy_goals import is_achieved

VECTOR_METADATA = {**METADATA, "autoreset_mode": AutoresetMode.NEXT_STEP}


class FetchVector(VectorEnv[Observation, np.ndarray, np.ndarray]):
    """A batch of one Fetch task; each row behaves as `FetchGymnasium` does alone.

    The step after a row's last one resets that row, whatever its action, with reward 0
    (Gymnasium's "next step" autoreset, the default of its own vector environments).

    It can be copied and pickled at any point, as `FetchGymnasium` can.

    Attributes:
        state: the present states of the functional environments, None before the first reset.
    """

    metadata = VECTOR_METADATA

    def __init__(
        self,
        task: str,
        num_envs: int = 1,
        *,
        max_episode_steps: int | None = None,
        engine: str = "native",
        render_mode: str | None = None,
        width: int = 640,
        height: int = 480,
        **fields: float,
    ) -> None:
        """Make the environments; nothing of JAX runs or compiles before the first reset.

        Args:
            task: "reach", "push" or "pick_and_place".
            num_envs: how many rows, n.
            max_episode_steps: steps per episode, by default 50; -1 for no limit.
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
        self.num_envs, self.render_mode = row_count(num_envs), render_mode
        self._programs = fetch_programs(task, engine, **fields)
        self.single_observation_space = observation_space(self.fetch)
        self.single_action_space = action_space(self.fetch)
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self.state: State | None = None
        self._step_limit = step_limit(max_episode_steps, self.fetch.episode_length)
        self._random: list[tuple[np.random.Generator, int]] | None = None
        self._elapsed = np.zeros(self.num_envs, int)
        self._ended = np.zeros(self.num_envs, bool)
        self._frames = Frames(self._programs, width, height)

    @property
    def distance_threshold(self) -> float:
        """A goal is achieved closer than this, metres."""
        return self.fetch.distance_threshold

    @property
    def fetch(self) -> FetchEnvironment:
        """The functional environment of one row."""
        return self._programs.env

    @property
    def np_random(self) -> tuple[np.random.Generator, ...]:  # pyright: ignore[reportIncompatibleMethodOverride]
        """The random number generator of each row."""
        return tuple(generator for generator, _ in self._row_randomness())

    @property
    def np_random_seed(self) -> tuple[int, ...]:  # pyright: ignore[reportIncompatibleMethodOverride]
        """The seed that each row's generator was last started with."""
        return tuple(seed for _, seed in self._row_randomness())

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[Observation, dict[str, Any]]:
        """Start an episode in every row, or in those of a mask.

        Args:
            seed: of the first row, the others counting on from there; or one for each row.
                None continues with the random numbers that the rows have.
            options: `reset_mask`, an array [n] of bool, restricts the reset and the seeds to its
                rows; the others stay where they are.

        Raises:
            ClosedEnvironmentError: after `close`.
            Error: a seed that is no integer, or below 0.
            ResetNeeded: a mask before the first reset that leaves rows without a state.
            RuntimeError: JAX would hang, since this process was forked after it had started.
            TypeError: options that are no dict, or a mask that is no array of bool.
            ValueError: another option, a mask of another shape or of no row, or not as many
                seeds as rows.
        """
        programs = self._usable_programs()
        rows, seeds = rows_to_reset(options, self.num_envs), row_seeds(seed, self.num_envs)
        if self.state is None and not rows.all():
            raise ResetNeeded("call reset for all rows before reset with a mask")
        self._random = [
            seeding.np_random(one) if row and one is not None else old
            for row, one, old in zip(rows, seeds, self._row_randomness(), strict=True)
        ]
        fresh = programs.reset_many(self._draw_seeds(rows))
        self.state = fresh if self.state is None else self._replace(rows, fresh, self.state)
        self._elapsed[rows], self._ended[rows] = 0, False
        return observation_of(self.state), {}

    def step(
        self, actions: np.ndarray
    ) -> tuple[Observation, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Advance rows by one control step with `actions` [n, 4]; reset those that have ended.

        Raises:
            ClosedEnvironmentError: after `close`.
            ResetNeeded: before the first reset.
            RuntimeError: as `reset`.
            ValueError: actions of another shape, or not finite in a row that they move.
        """
        programs, before = self._usable_programs(), self._state_for("step")
        restarted = self._ended
        shape = (self.num_envs, self.fetch.action_size)
        checked = checked_action(actions, shape, unused=restarted)
        self.state = self._advance(programs, before, checked, restarted)
        observation = observation_of(self.state)
        achieved, desired = observation["achieved_goal"], observation["desired_goal"]
        warnings = np.asarray(self.state.metrics["physics_warnings"]).astype(int)
        self._elapsed = np.where(restarted, 0, self._elapsed + 1)
        self._ended = (self._elapsed >= self._step_limit) | (warnings > 0)
        success = is_achieved(achieved, desired, self.fetch.distance_threshold)
        information = {
            "is_success": success & ~restarted,
            "_is_success": ~restarted,
            "physics_warnings": warnings,
            "_physics_warnings": ~restarted,
        }
        reward = np.where(restarted, 0.0, self.compute_reward(achieved, desired, information))
        terminated = np.zeros(self.num_envs, bool)
        return observation, reward, terminated, self._ended.copy(), information

    def compute_reward(
        self, achieved_goal: np.ndarray, desired_goal: np.ndarray, info: Any
    ) -> np.ndarray | np.float64:
        """Reward of goals [3], or of a batch of them [..., 3]; `info` has no part in it."""
        return reward_of(achieved_goal, desired_goal, self.fetch.distance_threshold)

    def render(self) -> tuple[np.ndarray, ...] | None:  # pyright: ignore[reportIncompatibleMethodOverride]
        """A frame [height, width, 3] uint8 of each row.

        Raises:
            ClosedEnvironmentError: after `close`.
            RenderingError: this machine cannot render.
            ResetNeeded: before the first reset.
        """
        self._check_open()
        if self.render_mode is None:
            warn_without_render_mode(self.spec.id if self.spec else type(self).__name__)
            return None
        return tuple(self._frames.draw(self._state_for("render")))

    def close_extras(self, **_: Any) -> None:
        """Free what rendering took."""
        self._frames.close()

    def _advance(
        self, programs: FetchPrograms, before: State, actions: np.ndarray, restarted: np.ndarray
    ) -> State:
        if restarted.all():
            return programs.reset_many(self._draw_seeds(restarted))
        after = programs.step_many(before, actions)
        if not restarted.any():
            return after
        return self._replace(restarted, programs.reset_many(self._draw_seeds(restarted)), after)

    def _replace(self, rows: np.ndarray, fresh: State, state: State) -> State:
        return fresh if rows.all() else self._programs.select(rows, fresh, state)

    def _row_randomness(self) -> list[tuple[np.random.Generator, int]]:
        """Generator and seed of each row; from the system's entropy where none was given."""
        if self._random is None:
            self._random = [seeding.np_random() for _ in range(self.num_envs)]
        return self._random

    def _draw_seeds(self, rows: np.ndarray) -> np.ndarray:
        """Seeds [n]; only the generators of `rows` [n] move on."""
        return np.array(
            [
                draw_seed(generator) if row else np.uint32(0)
                for generator, row in zip(self.np_random, rows, strict=True)
            ]
        )

    def _usable_programs(self) -> FetchPrograms:
        self._check_open()
        return self._programs.started()

    def _check_open(self) -> None:
        if self.closed:
            raise ClosedEnvironmentError("the vector environment has been closed")

    def _state_for(self, purpose: str) -> State:
        if self.state is None:
            raise ResetNeeded(f"call reset before {purpose}")
        return self.state
