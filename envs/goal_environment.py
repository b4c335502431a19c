"""What an environment must offer to be trained on, and what more it may offer."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import jax
import numpy as np

from cgm_jax.envs.quiet_import import State


@runtime_checkable
class GoalEnvironment(Protocol):
    """A goal-conditioned environment of pure functions, for one episode at a time.

    The trainer vmaps both functions over environments, and maps them over runs. `State` is brax's;
    `State.obs` is a dict of float32 arrays: `observation` [observation_size],
    `achieved_goal` [goal_size] and `desired_goal` [goal_size]. Nothing in `observation` tells the
    goal: hindsight, masks and curricula change that one alone.

    A goal is achieved where the Euclidean distance of achieved and desired goal is below
    `distance_threshold`; a masked goal where the distance over its kept dimensions is. The
    trainer computes rewards from that rule and does not read `State.reward`; nor does it
    read `State.done`, since every episode takes exactly `episode_length` steps. Other rules:
    `JudgingEnvironment`.

    An engine that detects broken physics sets `State.metrics["physics_warnings"]` to
    something above 0; the trainer then drops the episode, as it drops non-finite ones.

    Reward, done and the other metrics may be anything, and differ between `reset` and `step`. The
    goal stays what it was for the whole episode; and what an environment keeps for itself, in
    `pipeline_state`, in `info` or in further entries of `obs`, keeps its shapes and types.

    Attributes:
        action_size: number of action dimensions, each in [-1, 1].
        episode_length: steps per episode, T.
        distance_threshold: in the unit of the goal (metres for Fetch).
    """

    @property
    def action_size(self) -> int:
        """Number of action dimensions."""
        ...

    @property
    def episode_length(self) -> int:
        """Steps per episode, T."""
        ...

    @property
    def distance_threshold(self) -> float:
        """Distance below which a goal is achieved."""
        ...

    def reset(self, rng: jax.Array) -> State:
        """Start an episode with a new initial state and a new goal."""
        ...

    def step(self, state: State, action: jax.Array) -> State:
        """Advance by one control step with `action` [action_size]."""
        ...


class JudgingEnvironment(GoalEnvironment, Protocol):
    """An environment with rules of its own instead of those of distance and of length.

    All are optional, and each is recognised by its name. The functions are pure, for one episode.

    `goal_tolerance` [n], an array: a goal is achieved where the distance, each dimension measured
    in its tolerance, is below 1, so where sum_i ((achieved_i - desired_i) / tolerance_i)^2 < 1.
    `goal_success` says so by any other rule; there is one of the two at most.
    `goal_reward` replaces the reward of 0 for success and -1 otherwise in what the agents learn
    from; its values lie within `reward_range`, a pair (least, greatest).
    `is_terminal` ends episodes early: whatever the goal, nothing is to be had after that state.
    With rewards of 0 and -1 this makes an early failure worth more than a late success, since no
    step after it costs anything; so an episode that failed should rather go on where it did.

    Under a mask the functions of goals get a desired goal that, in masked dimensions, is the
    achieved one. Hindsight asks them about other goals than those of the episode.
    `distance_threshold` remains the scale of goals: of normalised inputs, and for curricula.
    """

    @property
    def goal_tolerance(self) -> jax.Array:
        """What each dimension of a goal may be off, [n]."""
        ...

    def goal_success(self, achieved_goal: jax.Array, desired_goal: jax.Array) -> jax.Array:
        """Whether a goal [n] is achieved, a bool scalar."""
        ...

    @property
    def reward_range(self) -> tuple[float, float]:
        """Least and greatest value of `goal_reward`."""
        ...

    def goal_reward(self, achieved_goal: jax.Array, desired_goal: jax.Array) -> jax.Array:
        """The reward of a step that achieves a goal [n], a float scalar."""
        ...

    def is_terminal(self, state: State) -> jax.Array:
        """Whether the episode ends in this state, a bool scalar."""
        ...


@runtime_checkable
class StartableEnvironment(GoalEnvironment, Protocol):
    """An environment whose episodes can also begin in a state that an earlier one visited.

    Optional: curricula that choose where to begin need it, and it is recognised by its method.
    """

    def restart(self, state: State) -> State:
        """Begin an episode in `state`, as it is, with the goal that it holds.

        Whatever counts within an episode, such as steps or warnings, begins anew.
        """
        ...


class RenderableEnvironment(GoalEnvironment, Protocol):
    """An environment whose episodes can be shown as a video.

    Optional: `python -m cgm_jax.evaluate ... --video` needs it.
    """

    def render_frame(self, state: State, width: int, height: int) -> np.ndarray:
        """Draw one concrete state as a frame [height, width, 3] of uint8.

        On the host and outside of any traced function: arrays of the state are numpy's. A video
        shows 25 frames, one per step, in a second.
        """
        ...


@dataclass(frozen=True)
class Stage:
    """A sub-goal on the way to an environment's goal, such as to touch what is to be moved.

    Both functions are of what is observed, so that replay need not hold anything more.

    Attributes:
        achieved: from an observation [o] to what of the sub-goal is achieved, [m].
        desired: from an observation [o] and a desired goal [n] to what should be, [m].
        size: entries of the sub-goal, m.
        distance_threshold: the sub-goal is achieved closer than this.
    """

    achieved: Callable[[jax.Array], jax.Array]
    desired: Callable[[jax.Array, jax.Array], jax.Array]
    size: int
    distance_threshold: float


class StagedEnvironment(GoalEnvironment, Protocol):
    """An environment that says what comes before its goal.

    Optional: `--relabelling relay` needs it, and it is recognised by this attribute. A stage that
    need not hold any more once a later one does says so by desiring what is achieved.
    """

    @property
    def stages(self) -> tuple[Stage, ...]:
        """Sub-goals, in the order in which they are to be achieved."""
        ...
