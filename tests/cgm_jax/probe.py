"""Environments so small that their values are known."""

# Brax types the parts of its State as unknown.
# pyright: reportAttributeAccessIssue=false, reportOptionalMemberAccess=false
# pyright: reportGeneralTypeIssues=false

from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
from brax.envs.base import State

from cgm_jax.config.grid import hyperparameters
from cgm_jax.config.settings import Hyperparameters, Settings


@dataclass(frozen=True)
class OneStepProbe:
    """One step, in which the sign of the action becomes the achieved goal.

    The observation is constant and the goal is drawn from `goals`, so that all steps are alike:
    Q(g, a) = r(g, a) + gamma * max_b Q(g, b).
    """

    goals: tuple[float, ...]
    goal_size: int = 1
    action_size: int = 1
    episode_length: int = 1
    distance_threshold: float = 0.05

    def reset(self, rng: jax.Array) -> State:
        goal = jnp.asarray(self.goals)[
            jax.random.randint(rng, (self.goal_size,), 0, len(self.goals))
        ]
        return self._state(jnp.zeros(self.goal_size), goal)

    def step(self, state: State, action: jax.Array) -> State:
        return self._state(jnp.where(action > 0, 1.0, -1.0), state.obs["desired_goal"])

    def _state(self, achieved_goal: jax.Array, goal: jax.Array) -> State:
        obs = {"observation": jnp.ones(1), "achieved_goal": achieved_goal, "desired_goal": goal}
        return State(pipeline_state=None, obs=obs, reward=jnp.zeros(()), done=jnp.zeros(()))


@dataclass(frozen=True)
class FaultyProbe(OneStepProbe):
    """The probe, with physics that break in about half of the episodes."""

    def reset(self, rng: jax.Array) -> State:
        state = super().reset(rng)
        state.metrics["physics_warnings"] = jnp.zeros(())
        return state.replace(obs={**state.obs, "observation": jax.random.uniform(rng, (1,))})

    def step(self, state: State, action: jax.Array) -> State:
        broken = state.obs["observation"][0] < 0.5
        after = super().step(state, action)
        after.metrics["physics_warnings"] = jnp.where(broken, 1.0, 0.0)
        return after.replace(
            obs={**after.obs, "observation": jnp.where(broken, jnp.nan, jnp.ones(1))}
        )


@dataclass(frozen=True)
class AlwaysFaultyProbe(OneStepProbe):
    """The probe, with physics that always break: in the step, or in the reset and not after it."""

    in_reset: bool = False

    def reset(self, rng: jax.Array) -> State:
        state = super().reset(rng)
        state.metrics["physics_warnings"] = jnp.float32(self.in_reset)
        return state

    def step(self, state: State, action: jax.Array) -> State:
        after = super().step(state, action)
        after.metrics["physics_warnings"] = jnp.float32(not self.in_reset)
        return after


def actor_that_needs_to_see_y(actor: Any) -> Any:
    """Parameters of the same shape whose actions are 1 where input 2 is 1, and -1 where it is 0.

    On a probe with two goal dimensions, which are always 1, input 2 is the goal's y; masked, it
    is the achieved one, 0 before the step. So this policy achieves x as long as it is asked for y.
    """
    actor = jax.tree.map(jnp.zeros_like, actor)
    first, second, last = (actor["params"][f"layer_{i}"] for i in range(3))
    first["kernel"] = first["kernel"].at[2, 0].set(1.0)
    second["kernel"] = second["kernel"].at[0, 0].set(1.0)
    last["kernel"] = last["kernel"].at[0, :].set(2.0)
    last["bias"] -= 1.0
    return actor


TINY = Settings(
    env="probe",
    cycles_per_epoch=2,
    environments=8,
    updates_per_cycle=4,
    batch_size=32,
    replay_transitions=1000,
    evaluation_episodes=10,
)
"""Static settings that compile in seconds."""


def tiny(**values: Any) -> Hyperparameters:
    """Settings of a run with networks that compile in seconds."""
    return hyperparameters(**{"hidden_layers": (16, 16), "target_update_every": 1, **values})
