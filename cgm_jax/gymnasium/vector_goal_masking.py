"""Curriculum goal masking for a Gymnasium vector environment that steps as one batch."""

from collections.abc import Mapping, Sequence
from typing import Any

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv, VectorWrapper
from numpy.typing import ArrayLike

from cgm_jax.gymnasium.goals import (
    Distance,
    Observation,
    apply_mask,
    batched_goal_space,
    check_masks,
    goal_space,
    make_rule,
    with_goal_space,
)
from cgm_jax.gymnasium.mask_sampler import MaskSampler, check_switch, mask_generator


class VectorGoalMasking(
    VectorWrapper[Observation, np.ndarray, Observation, np.ndarray, np.ndarray]
):
    """As `GoalMasking`, for E environments at once; each row behaves as one of them alone.

    All rows draw from one sampler. Entries of `info` are arrays [E, ...]; as in Gymnasium's own,
    `_name` [E] says in which rows `name` holds.

    Attributes:
        sampler: the mask sampler, with its probabilities and success rates.
        rule: when a goal counts as achieved.
        evaluating: whether episodes that start from now on have the full goal.
    """

    def __init__(
        self,
        env: VectorEnv[Observation, np.ndarray, np.ndarray],
        c_g: float = 0.1,
        kappa: float = 32.0,
        *,
        distance_threshold: ArrayLike | None = None,
        distance: Distance = "euclidean",
        history: int = 10,
        mask_levels: bool = False,
        evaluating: bool = False,
    ) -> None:
        """Wrap a vector environment.

        Args:
            env: resets a row in the step after its last ("next step"), or leaves resets to its
                user ("disabled").
            c_g: as for `GoalMasking`, and so the others.
            kappa: sharpness.
            distance_threshold: a goal is achieved closer than this. None: the environments'
                attribute of this name.
            distance: "euclidean" or "per_dimension".
            history: h.
            mask_levels: draw a difficulty first.
            evaluating: always the full goal.

        Raises:
            ValueError: an argument out of its range, no goal environments, or ones that reset
                within the step that ends an episode.
        """
        super().__init__(env)
        self._autoreset = env.metadata.get("autoreset_mode")
        if self._autoreset not in (AutoresetMode.NEXT_STEP, AutoresetMode.DISABLED):
            raise ValueError(
                f"autoreset_mode: {self._autoreset} is neither NEXT_STEP nor DISABLED; wrap each "
                "environment in GoalMasking instead, with make_vec(..., wrappers=[...])"
            )
        goals = goal_space(env.single_observation_space)
        self.single_observation_space = with_goal_space(env.single_observation_space, goals)  # pyright: ignore
        self.observation_space = with_goal_space(
            env.observation_space,  # pyright: ignore[reportArgumentType]
            batched_goal_space(env.observation_space),  # pyright: ignore[reportArgumentType]
        )
        if distance_threshold is None:
            distance_threshold = _own_threshold(env)
        self.rule = make_rule(goals.shape[0], distance_threshold, distance)
        self.sampler = MaskSampler(goals.shape[0], c_g, kappa, history, mask_levels)
        check_switch("evaluating", evaluating)
        self.evaluating = evaluating
        self._generators = [mask_generator(None) for _ in range(env.num_envs)]
        self._masks = np.ones((env.num_envs, goals.shape[0]), bool)
        self._ended: np.ndarray | None = None

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[Observation, dict[str, Any]]:
        """Start episodes under new masks.

        Args:
            seed: of the first row, the others counting on from there; or one for each row.
            options: `mask`, [n] or [E, n] of 0 and 1, is these episodes'; `reset_mask` [E] resets
                only some rows; the others are the environment's.

        Raises:
            TypeError: `options` are no dict.
            ValueError: `mask` has another shape, or holds something else.
        """
        if options is not None and not isinstance(options, Mapping):
            raise TypeError(f"options: {options!r} is neither a dict nor None")
        options, forced = dict(options or {}), None
        if "mask" in options:
            forced = check_masks(options.pop("mask"), self._masks.shape)
        rows = np.array(options.get("reset_mask", np.ones(self.num_envs, bool)))
        observation, info = self.env.reset(seed=seed, options=options or None)  # pyright: ignore
        self._seed(seed, rows)
        self._draw(rows, forced)
        self._ended = np.zeros(self.num_envs, bool) if self._ended is None else self._ended & ~rows
        info = {**info, "mask": self._masks.copy(), "_mask": rows}
        return apply_mask(observation, self._masks), info

    def step(
        self, actions: np.ndarray
    ) -> tuple[Observation, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Advance all rows; those that the environment resets start under a new mask.

        Raises:
            gymnasium.error.ResetNeeded: there was no reset.
        """
        if self._ended is None:
            raise gymnasium.error.ResetNeeded("call reset before step")
        restarted = self._ended & (self._autoreset == AutoresetMode.NEXT_STEP)
        observation, _, terminated, truncated, info = self.env.step(actions)
        self._draw(restarted, None)
        self._ended = terminated | truncated
        masked = apply_mask(observation, self._masks)
        achieved, goal = observation["achieved_goal"], observation["desired_goal"]
        reward = np.asarray(self.compute_reward(achieved, masked["desired_goal"], info))
        reward = np.where(restarted, 0.0, reward)
        stepped = ~restarted
        subgoal_success = self.rule.subgoals_achieved(achieved, goal) & stepped[:, None]
        info = {
            "is_success": self.rule.is_achieved(achieved, goal) & stepped,
            "_is_success": stepped,
            **info,
            "mask": self._masks.copy(),
            "_mask": np.ones(self.num_envs, bool),
            "masked_success": (reward == 0.0) & stepped,
            "_masked_success": stepped,
            "subgoal_success": subgoal_success,
            "_subgoal_success": stepped,
        }
        return masked, reward, terminated, truncated, info

    def compute_reward(
        self, achieved_goal: np.ndarray, desired_goal: np.ndarray, info: Any
    ) -> np.ndarray | np.float64:
        """Reward of (masked) goals [..., n], as `GoalMasking.compute_reward`."""
        return self.rule.reward(achieved_goal, desired_goal)

    def record_evaluation(self, subgoal_success: ArrayLike) -> None:
        """Add noise-free episodes with the full goal to what the sampler knows.

        Args:
            subgoal_success: of the last step of each, [n] or [k, n], the newest last.

        Raises:
            ValueError: another shape, or something else than 0 and 1.
        """
        self.sampler.record(subgoal_success)

    def _seed(self, seed: int | Sequence[int | None] | None, rows: np.ndarray) -> None:
        if seed is None:
            return
        seeds = [seed + i for i in range(self.num_envs)] if isinstance(seed, int) else seed
        for i, one in enumerate(seeds):
            if one is not None and rows[i]:
                self._generators[i] = mask_generator(one)

    def _draw(self, rows: np.ndarray, forced: np.ndarray | None) -> None:
        """New masks for `rows` [E] bool."""
        for i in np.flatnonzero(rows):
            if forced is not None:
                self._masks[i] = forced[i]
            elif self.evaluating:
                self._masks[i] = True
            else:
                self._masks[i] = self.sampler.sample(self._generators[i])


def _own_threshold(env: VectorEnv[Any, Any, Any]) -> Any:
    """`distance_threshold` of the vector environment, or of the environments in it; else None.

    Asked first whether they have it: workers of an `AsyncVectorEnv` end over what they do not have.

    Raises:
        ValueError: the environments in it differ in theirs.
    """
    own = getattr(env.unwrapped, "distance_threshold", None)
    if own is not None or not hasattr(env.unwrapped, "call"):
        return own
    within: Any = env.unwrapped
    if not all(within.call("has_wrapper_attr", "distance_threshold")):
        return None
    first, *others = within.get_attr("distance_threshold")
    if not all(np.array_equal(first, other) for other in others):
        raise ValueError("distance_threshold: the environments differ in theirs; give one")
    return first
