"""Curriculum goal masking for any Gymnasium goal environment, in numpy.

    env = GoalMasking(gymnasium.make(...), c_g=0.1, kappa=32)
    evaluation = GoalMasking(gymnasium.make(...), evaluating=True)
    ...                                     # train on env; at times run evaluation, without noise
    env.record_evaluation(info["subgoal_success"])   # info of an evaluation episode's last step

Hindsight needs nothing more. A masked dimension of `desired_goal` is the goal achieved at that
very step, so it is achieved; a stored transition thus carries its mask in its two goals, and the
reward of `compute_reward(next achieved goal, goal)` is right for the masked goal of the *next*
observation and, with every dimension counting, for a goal that was achieved later. That is what
Stable-Baselines3's `HerReplayBuffer` asks for; infos have no part in it.
"""

from typing import Any

import gymnasium
import numpy as np
from gymnasium.utils import RecordConstructorArgs
from numpy.typing import ArrayLike

from cgm_jax.gymnasium.goals import (
    Distance,
    Observation,
    apply_mask,
    check_masks,
    goal_space,
    make_rule,
    with_goal_space,
)
from cgm_jax.gymnasium.mask_sampler import MaskSampler, check_switch, mask_generator


class GoalMasking(gymnasium.Wrapper[Observation, Any, Observation, Any], RecordConstructorArgs):
    """Masks the goal of every episode, so that it is about as hard as wished.

    Each reset draws a mask (Eppe, Magg and Wermter 2019); each observation's `desired_goal` then
    holds the goal in the kept dimensions and the goal achieved at that step in the masked ones.
    The reward is the paper's, 0 where the masked goal is achieved and -1 elsewhere, whatever the
    environment's own. When an episode ends is left to the environment; one that terminates on
    failure makes that worth more than a late success, since no step after it costs anything, and so
    should rather go on where it failed.

    `info` says at every step `mask` [n] (True where the goal counts), `masked_success`, and of the
    goal without mask `is_success` (the environment's own where it has one) and `subgoal_success`
    [n], the dimensions that are closer than the threshold. A reset's has `mask`.

    Attributes:
        sampler: the mask sampler, with its probabilities and success rates.
        rule: when a goal counts as achieved.
        evaluating: whether episodes that start from now on have the full goal.
    """

    def __init__(
        self,
        env: gymnasium.Env[Observation, Any],
        c_g: float = 0.1,
        kappa: float = 32.0,
        *,
        distance_threshold: ArrayLike | None = None,
        distance: Distance = "euclidean",
        history: int = 10,
        mask_levels: bool = False,
        evaluating: bool = False,
    ) -> None:
        """Wrap an environment.

        Args:
            env: with a Dict of observation, achieved_goal and desired_goal, the goals Boxes [n].
            c_g: the success rate aimed at, in [0, 1].
            kappa: sharpness, 0 (masks are drawn uniformly) to 10^6.
            distance_threshold: a goal is achieved closer than this; a scalar, or [n] with
                `distance="per_dimension"`. None: the environment's attribute of this name.
            distance: "euclidean", or "per_dimension" for dimensions of unlike units.
            history: h, how many of the latest evaluation episodes count.
            mask_levels: draw a difficulty first, then a mask of that difficulty, which goals of
                many dimensions need; not in the paper.
            evaluating: always the full goal.

        Raises:
            ValueError: an argument out of its range, no goal environment, a goal of more than 512
                dimensions, or an environment that resets itself, of which no mask would know.
        """
        gymnasium.Wrapper.__init__(self, env)
        _check_not_reset(env)
        goals = goal_space(env.observation_space)
        self.observation_space = with_goal_space(env.observation_space, goals)  # pyright: ignore
        threshold = distance_threshold
        if threshold is None and env.has_wrapper_attr("distance_threshold"):
            threshold = env.get_wrapper_attr("distance_threshold")
        self.rule = make_rule(goals.shape[0], threshold, distance)
        self.sampler = MaskSampler(goals.shape[0], c_g, kappa, history, mask_levels)
        check_switch("evaluating", evaluating)
        self.evaluating = evaluating
        self._generator = mask_generator(None)
        self._mask: np.ndarray | None = None
        given = None if distance_threshold is None else np.asarray(distance_threshold).tolist()
        # Python's own numbers, since they go into the spec, which is compared and written as JSON.
        RecordConstructorArgs.__init__(
            self,
            c_g=float(c_g),
            kappa=float(kappa),
            distance_threshold=given,
            distance=distance,
            history=int(history),
            mask_levels=mask_levels,
            evaluating=evaluating,
        )

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Start an episode under a new mask.

        Args:
            seed: also decides the masks from now on, and leaves the environment's own random
                numbers as they are without this wrapper.
            options: `mask` [n] of 0 and 1 is this episode's; the others are the environment's.

        Raises:
            ValueError: `mask` has another shape, or holds something else.
        """
        shape = (self.sampler.goal_size,)
        forced = None
        if options is not None and "mask" in options:
            forced = check_masks(options["mask"], shape)
            options = {name: value for name, value in options.items() if name != "mask"}
        observation, info = self.env.reset(seed=seed, options=options)
        if seed is not None:
            self._generator = mask_generator(seed)
        if forced is not None:
            self._mask = forced
        elif self.evaluating:
            self._mask = np.ones(shape, bool)
        else:
            self._mask = self.sampler.sample(self._generator)
        return apply_mask(observation, self._mask), {**info, "mask": self._mask.copy()}

    def step(self, action: Any) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Advance the environment by `action`.

        Raises:
            gymnasium.error.ResetNeeded: there was no reset.
        """
        if self._mask is None:
            raise gymnasium.error.ResetNeeded("call reset before step")
        observation, _, terminated, truncated, info = self.env.step(action)
        masked = apply_mask(observation, self._mask)
        achieved, goal = observation["achieved_goal"], observation["desired_goal"]
        reward = float(self.compute_reward(achieved, masked["desired_goal"], info))
        info = {
            "is_success": bool(self.rule.is_achieved(achieved, goal)),
            **info,
            "mask": self._mask.copy(),
            "masked_success": reward == 0.0,
            "subgoal_success": self.rule.subgoals_achieved(achieved, goal),
        }
        return masked, reward, terminated, truncated, info

    def compute_reward(
        self, achieved_goal: np.ndarray, desired_goal: np.ndarray, info: Any
    ) -> np.ndarray | np.float64:
        """Reward of (masked) goals [n], or of a batch of them [..., n].

        Args:
            achieved_goal: after the action.
            desired_goal: of the observation after the action, or achieved later.
            info: without effect: a goal achieved later counts in all dimensions, whatever the
                episode's mask.
        """
        return self.rule.reward(achieved_goal, desired_goal)

    def record_evaluation(self, subgoal_success: ArrayLike) -> None:
        """Add noise-free episodes with the full goal to what the sampler knows.

        Args:
            subgoal_success: of the last step of each, [n] or [k, n], the newest last.

        Raises:
            ValueError: another shape, or something else than 0 and 1.
        """
        self.sampler.record(subgoal_success)


def _check_not_reset(env: gymnasium.Env[Any, Any]) -> None:
    """Check that no wrapper below resets the environment by itself.

    Raises:
        ValueError: one does.
    """
    while isinstance(env, gymnasium.Wrapper):
        if isinstance(env, gymnasium.wrappers.Autoreset):
            raise ValueError("env: Autoreset draws no masks; put it around GoalMasking instead")
        env = env.env
