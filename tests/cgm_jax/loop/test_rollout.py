"""Episodes that do not count, and what of them must not."""

# Brax types the parts of its State as unknown.
# pyright: reportAttributeAccessIssue=false, reportArgumentType=false, reportCallIssue=false

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from brax.envs.base import State

from cgm_jax.loop.cycle import store
from cgm_jax.loop.rollout import drawn_goals, reset, roll_out
from cgm_jax.loop.training import make_trainer
from tests.cgm_jax.probe import TINY, OneStepProbe, tiny


@dataclasses.dataclass(frozen=True)
class LuckyWhereBroken(OneStepProbe):
    """Half of the episodes break, and only those move to the goal; all numbers are finite."""

    goals: tuple[float, ...] = (1.0,)

    def reset(self, rng: jax.Array) -> State:
        state = super().reset(rng).replace(pipeline_state=jax.random.bernoulli(rng))
        state.metrics["physics_warnings"] = jnp.zeros(())
        return state

    def step(self, state: State, action: jax.Array) -> State:
        luck: Any = state.pipeline_state
        after = self._state(jnp.where(luck, 1.0, 0.0)[None], state.obs["desired_goal"])
        after.metrics["physics_warnings"] = jnp.where(luck, 1.0, 0.0)
        return after.replace(pipeline_state=luck)


def test_what_broken_episodes_achieved_counts_nowhere() -> None:
    trainer, hyper = make_trainer(LuckyWhereBroken(), TINY), tiny(curriculum="full")
    state, metrics = jax.jit(trainer.epoch)(trainer.init(hyper), hyper)
    kept = int(state.replay.inserted)
    assert 0 < kept < 16
    assert 0 < int(metrics["evaluated_episodes"]) < 10
    assert float(metrics["success_rate"]) == 0.0
    assert float(metrics["subgoal_success"][0]) == 0.0
    assert float(metrics["mask_rate_training"][1]) == 0.0
    assert float(metrics["moved_share"]) == 0.0
    assert int(state.normaliser.goal.count.lo) == 2 * kept


@dataclasses.dataclass(frozen=True)
class BrokenOnce(OneStepProbe):
    """Of three steps one breaks the physics, and says so then only."""

    goals: tuple[float, ...] = (1.0,)
    episode_length: int = 3
    breaks: float = 0.0

    def reset(self, rng: jax.Array) -> State:
        state = super().reset(rng).replace(pipeline_state=jnp.zeros(()))
        state.metrics["physics_warnings"] = jnp.zeros(())
        return state

    def step(self, state: State, action: jax.Array) -> State:
        steps: Any = state.pipeline_state
        after = super().step(state, action).replace(pipeline_state=steps + 1.0)
        after.metrics["physics_warnings"] = jnp.where(steps == self.breaks, 1.0, 0.0)
        return after


def forward(observation: jax.Array, goal: jax.Array, noise: Any) -> jax.Array:
    """A policy of ones."""
    del noise
    return jnp.ones((len(observation), goal.shape[-1]))


@pytest.mark.parametrize("step", [0.0, 1.0, 2.0])
def test_a_warning_at_any_step_drops_the_episode(step: float) -> None:
    env = BrokenOnce(breaks=step)
    first = reset(env, jax.random.key(0), 2)
    rollout = roll_out(env, forward, first, drawn_goals(env, first))
    assert rollout.broken.tolist() == [True, True]
    assert rollout.outcomes.valid.tolist() == [False, False]


def test_a_goal_that_is_not_finite_where_it_is_masked_drops_no_episode() -> None:
    env = OneStepProbe((1.0,), goal_size=2, action_size=2)
    first = reset(env, jax.random.key(0), 2)
    goals = drawn_goals(env, first)
    goals = goals.replace(
        desired=goals.desired.at[:, 0].set(jnp.nan), mask=jnp.array([[0.0, 1.0], [1.0, 1.0]])
    )
    rollout = roll_out(env, forward, first, goals)
    assert rollout.outcomes.valid.tolist() == [True, False]


def test_the_normalisers_settings_are_those_of_the_run() -> None:
    settings = dataclasses.replace(TINY, normaliser_limit=2.0, normaliser_floor=0.5)
    env = OneStepProbe((0.0,))
    trainer, hyper = make_trainer(env, settings), tiny(curriculum="full")
    state = trainer.init(hyper)
    assert float(state.normaliser.limit) == 2.0
    first = reset(env, jax.random.key(0), 8)
    rollout = roll_out(env, forward, first, drawn_goals(env, first))
    after = store(trainer.setup, state, hyper, rollout)
    # The observation never varies: half a distance threshold of 0.05.
    np.testing.assert_allclose(after.normaliser.observation.std, 0.025, rtol=1e-6)


def test_the_normaliser_sees_goals_of_the_environment_that_no_episode_was_to_achieve() -> None:
    env = OneStepProbe((-8.0, 8.0))
    trainer, hyper = make_trainer(env, TINY), tiny(curriculum="full")
    first = reset(env, jax.random.key(0), 64)
    drawn = drawn_goals(env, first)
    chosen = drawn.replace(desired=jnp.zeros_like(drawn.desired))
    rollout = roll_out(env, forward, first, chosen)
    np.testing.assert_array_equal(rollout.drawn_goal, drawn.desired)
    np.testing.assert_array_equal(rollout.episodes.desired_goal, 0.0)
    after = store(trainer.setup, trainer.init(hyper), hyper, rollout)
    # Achieved is 1; of the desired ones half are 0, and half those that were drawn.
    rows = np.concatenate([np.ones(64), np.zeros(32), np.asarray(drawn.desired)[1::2, 0]])
    np.testing.assert_allclose(after.normaliser.goal.std, rows.std(), rtol=1e-5)
