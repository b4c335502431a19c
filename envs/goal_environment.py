"""What an environment must offer to be trained on, and what more it may offer."""

from typing import Protocol, runtime_checkable

import jax

from cgm_jax.envs.quiet_import import State


@runtime_checkable
class GoalEnvironment(Protocol):
    """A goal-conditioned environment of pure functions, for one episode at a time.

    The trainer vmaps both functions over environments and over runs. `State` is brax's;
    `State.obs` is a dict of float32 arrays: `observation` [observation_size],
    `achieved_goal` [goal_size] and `desired_goal` [goal_size].

    A goal is achieved where the Euclidean distance of achieved and desired goal is below
    `distance_threshold`; a masked goal where the distance over its kept dimensions is. The
    trainer computes rewards from that rule and does not read `State.reward`; nor does it
    read `State.done`, since every episode takes exactly `episode_length` steps.

    An engine that detects broken physics sets `State.metrics["physics_warnings"]` to
    something above 0; the trainer then drops the episode, as it drops non-finite ones.

    Reward, done and the other metrics may be anything, and differ between `reset` and `step`. The
    goal stays what it was for the whole episode; and what an environment keeps for itself, in
    `pipeline_state`, in `info` or in further entries of `obs`, keeps its shapes.

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
