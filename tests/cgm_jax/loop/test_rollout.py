"""Episodes that do not count, and what of them must not."""

# Brax types the parts of its State as unknown.
# pyright: reportAttributeAccessIssue=false, reportArgumentType=false, reportCallIssue=false

import dataclasses
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from brax.envs.base import State

from cgm_jax.config.settings import Hyperparameters, Settings
from cgm_jax.curricula.protocol import Goals
from cgm_jax.envs import GoalEnvironment
from cgm_jax.loop.cycle import store
from cgm_jax.loop.own_checks import checked
from cgm_jax.loop.rollout import Rollout, drawn_goals, reset, roll_out
from cgm_jax.loop.state import TrainingState
from cgm_jax.loop.training import make_trainer
from tests.cgm_jax.probe import TINY, AlwaysFaultyProbe, FaultyProbe, OneStepProbe, tiny


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
    state, metrics = jax.jit(trainer.epoch)(jax.jit(trainer.init)(hyper), hyper)
    kept, evaluated = int(state.replay.inserted), int(metrics["evaluated_episodes"])
    assert 0 < kept < 16
    assert 0 < evaluated < 10
    assert float(metrics["physics_warnings"]) == 16 - kept + 10 - evaluated
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


def play(
    env: GoalEnvironment, count: int, change: Callable[[Goals], Goals] = lambda goals: goals
) -> Rollout:
    """So many episodes in which `forward` acts, with goals that `change` makes of those drawn."""

    @jax.jit
    def played(key: jax.Array) -> Rollout:
        first = reset(env, key, count)
        return roll_out(env, forward, first, change(drawn_goals(env, first)))

    return played(jax.random.key(0))


def stored(
    env: GoalEnvironment, rollout: Rollout, hyper: Hyperparameters, settings: Settings = TINY
) -> TrainingState:
    """What becomes of a run by its first episodes, before it learns from them."""
    trainer = make_trainer(env, settings)
    after = jax.jit(lambda it: store(trainer.setup, trainer.init(hyper), hyper, it))
    return after(rollout)


@pytest.mark.parametrize("step", [0.0, 1.0, 2.0])
def test_a_warning_at_any_step_drops_the_episode(step: float) -> None:
    rollout = play(BrokenOnce(breaks=step), 2)
    assert rollout.broken.tolist() == [True, True]
    assert rollout.outcomes.valid.tolist() == [False, False]


@pytest.mark.parametrize("wrap", [lambda env: env, lambda env: checked(env, "it")])
def test_physics_that_broke_in_a_reset_drop_the_episode(wrap: Any) -> None:
    rollout = play(wrap(AlwaysFaultyProbe((1.0,), in_reset=True)), 2)
    assert rollout.broken.tolist() == [True, True]
    assert rollout.outcomes.valid.tolist() == [False, False]


def test_a_goal_that_is_not_finite_where_it_is_masked_drops_no_episode() -> None:
    def change(goals: Goals) -> Goals:
        mask = jnp.array([[0.0, 1.0], [1.0, 1.0]])
        return goals.replace(desired=goals.desired.at[:, 0].set(jnp.nan), mask=mask)

    rollout = play(OneStepProbe((1.0,), goal_size=2, action_size=2), 2, change)
    assert rollout.outcomes.valid.tolist() == [True, False]


def test_of_episodes_with_broken_physics_no_number_that_is_not_finite_stays() -> None:
    env = FaultyProbe((1.0, -1.0))
    rollout = play(env, 16)
    after = stored(env, rollout, tiny())
    assert np.isnan(rollout.episodes.observation).any()
    assert 0 < int(after.replay.inserted) < 16
    for leaf in jax.tree.leaves(after.replace(key=None)):
        assert np.isfinite(leaf).all()


def test_the_normalisers_settings_are_those_of_the_run() -> None:
    settings = dataclasses.replace(TINY, normaliser_limit=2.0, normaliser_floor=0.5)
    env = OneStepProbe((0.0,))
    after = stored(env, play(env, 8), tiny(curriculum="full"), settings)
    assert float(after.normaliser.limit) == 2.0
    # The observation never varies: half a distance threshold of 0.05.
    np.testing.assert_allclose(after.normaliser.observation.std, 0.025, rtol=1e-6)


def test_the_normaliser_sees_goals_of_the_environment_that_no_episode_was_to_achieve() -> None:
    env = OneStepProbe((-8.0, 8.0))
    drawn = drawn_goals(env, reset(env, jax.random.key(0), 64)).desired
    rollout = play(env, 64, lambda goals: goals.replace(desired=jnp.zeros_like(goals.desired)))
    after = stored(env, rollout, tiny(curriculum="full"))
    np.testing.assert_array_equal(rollout.drawn_goal, drawn)
    np.testing.assert_array_equal(rollout.episodes.desired_goal, 0.0)
    # Achieved is 1; of the desired ones half are 0, and half those that were drawn.
    rows = np.concatenate([np.ones(64), np.zeros(32), np.asarray(drawn)[1::2, 0]])
    np.testing.assert_allclose(after.normaliser.goal.std, rows.std(), rtol=1e-5)
