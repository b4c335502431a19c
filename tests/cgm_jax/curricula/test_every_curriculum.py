"""What the protocol asks of a curriculum, asked of every one that comes with this package."""

import functools
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from cgm_jax.config.components import builtin
from cgm_jax.config.fields import SettingError, stack
from cgm_jax.config.grid import hyperparameters
from cgm_jax.config.settings import Hyperparameters, Settings
from cgm_jax.curricula.protocol import Curriculum, Goals, Outcomes, View
from cgm_jax.envs import GoalEnvironment
from cgm_jax.loop.own_checks import checked
from cgm_jax.loop.rollout import drawn_goals, reset
from cgm_jax.loop.state import TrainingState
from cgm_jax.loop.training import Programs, make_programs, make_trainer
from cgm_jax.measuring.compilations import programs_compiled
from cgm_jax.replay.ring import Replay, size
from tests.cgm_jax.protocols import (
    assert_no_type_is_promoted,
    assert_same,
    assert_training_resumes,
    assert_wrong_settings_are_refused_by_name,
    other_values,
)
from tests.examples.point_mass import PointMass

NAMES = sorted(builtin("curriculum"))
COUNT, CYCLES = 8, 2
ENV = PointMass()
SETTINGS = Settings(
    env="probe",
    cycles_per_epoch=CYCLES,
    environments=COUNT,
    updates_per_cycle=1,
    batch_size=8,
    replay_transitions=1000,
    evaluation_episodes=4,
)
TRAINER = make_trainer(ENV, SETTINGS)


def critics_for(name: str) -> int:
    """One critic, which compiles fastest, or three where a curriculum asks for several."""
    try:
        jax.eval_shape(TRAINER.init, hyperparameters(curriculum=name, critics=1))
    except SettingError:
        return 3
    return 1


@functools.cache
def two_runs(name: str) -> list[Hyperparameters]:
    """Two runs that differ in the seed and in every traced setting of the curriculum."""
    agent = {"hidden_layers": (8,), "target_update_every": 1, "critics": critics_for(name)}
    others = other_values("curriculum", name)
    return [
        hyperparameters(curriculum=name, seed=0, **agent),
        hyperparameters(curriculum=name, seed=1, **agent, **others),
    ]


class Trained(NamedTuple):
    """Two epochs of two runs side by side."""

    runs: list[Hyperparameters]
    programs: Programs
    start: Any  # the shapes of a state
    state: TrainingState
    metrics: list[dict[str, np.ndarray]]
    compiled: list[int]  # programs, so far, after each epoch

    @property
    def curriculum(self) -> "Curriculum[Any]":
        """That of the first run."""
        return jax.tree.map(jnp.asarray, stack(self.runs[:1])).curriculum

    def own_state(self, run: int = 0) -> Any:
        """The curriculum's state in one run."""
        return jax.tree.map(lambda leaf: leaf[run], self.state.curriculum)


@functools.cache
def trained(name: str) -> Trained:
    runs, programs = two_runs(name), make_programs(TRAINER)
    hyper = stack(runs)
    state = programs.start(hyper)
    start = jax.eval_shape(lambda: state)
    metrics, compiled = [], []
    for _ in range(2):
        state = programs.train(state, hyper, CYCLES)
        state, measured = programs.evaluate(state, hyper)
        metrics.append(jax.tree.map(np.asarray, measured))
        compiled.append(programs_compiled())
    return Trained(runs, programs, start, state, metrics, compiled)


def value(observation: jax.Array, goal: jax.Array) -> jax.Array:
    """Three critics that disagree the more, the farther a goal is away."""
    far = jnp.square(goal).sum(-1) + 0.0 * observation.sum(-1)
    return jnp.stack([-far, -2.0 * far, -3.0 * far])


def further_goals(key: jax.Array, count: int) -> jax.Array:
    """Goals that the environment draws, [count, n]."""
    return reset(ENV, key, count).obs["desired_goal"]


@jax.jit
def sample(curriculum: Any, state: Any, replay: Replay, key: jax.Array) -> Goals:
    """Goals for a cycle of one run."""
    first = reset(ENV, jax.random.key(3), COUNT)
    view = View(first, replay.episodes.achieved_goal, size(replay), value, further_goals)
    return curriculum.sample(state, key, drawn_goals(ENV, first), view)


@functools.partial(jax.jit, static_argnames="function")
def learn(curriculum: Any, state: Any, outcomes: Outcomes, function: str) -> Any:
    """The curriculum's state after one of its functions, `after_training` or `after_evaluation`."""
    return getattr(curriculum, function)(state, outcomes)


def outcomes(curriculum: Any, goals: Goals, valid: np.ndarray, invalid_success: bool) -> Outcomes:
    """Valid episodes succeed in turns; those that are not valid alike, and one is not finite."""
    first = reset(ENV, jax.random.key(4), COUNT)
    success = jnp.where(valid, jnp.arange(COUNT) % 2 == 0, invalid_success)
    observation = first.obs["observation"]
    if invalid_success:
        observation = jnp.where(valid[:, None], observation, jnp.nan)
    return Outcomes(
        goals=goals,
        success=success,
        subgoal_success=jnp.repeat(success[:, None], goals.mask.shape[1], axis=1),
        valid=jnp.asarray(valid),
        observation=observation,
        visited=first if curriculum.wants_visited else None,
    )


@pytest.fixture(params=NAMES)
def name(request: pytest.FixtureRequest) -> str:
    return request.param


def test_it_compiles_once_and_its_state_keeps_its_shape(name: str) -> None:
    done = trained(name)
    assert done.compiled[1] == done.compiled[0] > 0
    assert jax.tree.structure(done.state) == jax.tree.structure(done.start)
    end = jax.eval_shape(lambda: done.state)
    for before, after in zip(*map(jax.tree.leaves, (done.start, end)), strict=True):
        assert (before.shape, before.dtype) == (after.shape, after.dtype)
        assert not before.weak_type
        assert not after.weak_type


def test_training_practises_possible_goals_and_reports_one_row_per_run(name: str) -> None:
    done = trained(name)
    episodes = 2 * CYCLES * COUNT
    stored = jax.tree.map(lambda leaf: np.asarray(leaf)[:, :episodes], done.state.replay.episodes)
    np.testing.assert_array_equal(done.state.replay.inserted, episodes)
    assert set(np.unique(stored.mask)) <= {0.0, 1.0}
    assert (stored.threshold > 0.0).all()
    assert np.isfinite(stored.desired_goal).all()
    for metrics in done.metrics:
        assert {len(leaf) for leaf in metrics.values()} == {2}
        reported = done.curriculum.report(done.own_state())
        assert set(reported) <= set(metrics)


def test_runs_with_other_settings_are_vmapped(name: str) -> None:
    done, key = trained(name), jax.random.key(5)
    replay = jax.tree.map(lambda leaf: leaf[0], done.state.replay)
    curricula = stack(done.runs).curriculum
    side_by_side = jax.jit(jax.vmap(sample, (0, 0, None, None), axis_size=2))
    together = side_by_side(curricula, done.state.curriculum, replay, key)
    for run in range(2):
        curriculum = jax.tree.map(lambda leaf, i=run: leaf[i], curricula)
        alone = sample(curriculum, done.own_state(run), replay, key)
        assert jax.tree.structure(alone) == jax.tree.structure(together)
        for one, other in zip(*map(jax.tree.leaves, (alone, together)), strict=True):
            np.testing.assert_allclose(one, other[run], rtol=1e-5, atol=1e-6)
            assert one.dtype == other.dtype
            assert not other.weak_type
        assert alone.mask.shape == (COUNT, 2)
        assert alone.threshold.shape == (COUNT,)


def test_episodes_with_broken_physics_change_nothing(name: str) -> None:
    done = trained(name)
    before, replay = done.own_state(), jax.tree.map(lambda leaf: leaf[0], done.state.replay)
    curriculum = jax.tree.map(lambda leaf: leaf[0], done.curriculum)
    goals = sample(curriculum, before, replay, jax.random.key(6))
    some = np.arange(COUNT) % 3 > 0
    for function in ("after_training", "after_evaluation"):
        nothing = outcomes(curriculum, goals, np.zeros(COUNT, bool), invalid_success=True)
        assert_same(learn(curriculum, before, nothing, function), before)
        one, other = (
            learn(curriculum, before, outcomes(curriculum, goals, some, success), function)
            for success in (True, False)
        )
        assert_same(one, other)


def test_it_resumes_from_a_checkpoint(name: str, tmp_path: Path) -> None:
    done = trained(name)
    assert_training_resumes(done.programs, stack(done.runs), done.state, done.start, tmp_path)


def test_no_type_is_promoted(name: str) -> None:
    assert_no_type_is_promoted(TRAINER, stack(two_runs(name)))


def assert_types_are_kept_with_64_bits(env: GoalEnvironment, name: str) -> None:
    with jax.enable_x64(True):
        trainer, hyper = make_trainer(env, SETTINGS), two_runs(name)[0]
        before = jax.eval_shape(trainer.init, hyper)
        after, _ = jax.eval_shape(trainer.epoch, before, hyper)
    kept = jax.tree.map(lambda one, other: one.dtype == other.dtype, before, after)
    assert all(jax.tree.leaves(kept))


def test_with_64_bits_its_state_keeps_its_types(name: str) -> None:
    assert_types_are_kept_with_64_bits(ENV, name)


@pytest.mark.parametrize("name", ["cgm", "starts"])  # which holds no states of it, and which does
def test_with_64_bits_types_are_kept_of_an_environment_of_the_users_own(name: str) -> None:
    assert_types_are_kept_with_64_bits(checked(ENV, "it"), name)


def test_without_a_curriculum_only_the_full_goal_is_practised() -> None:
    done = trained("full")
    for metrics in done.metrics:
        # 0 / 0 marks masks that were never drawn.
        never = np.isnan(metrics["mask_rate_training"])
        np.testing.assert_array_equal(never, [[True, True, True, False]] * 2)
        np.testing.assert_array_equal(metrics["mask_share"], [[0.0, 0.0, 0.0, 1.0]] * 2)
        assert "mask_probability" not in metrics
    stored = np.asarray(done.state.replay.episodes.mask)[:, : 2 * CYCLES * COUNT]
    np.testing.assert_array_equal(stored, 1.0)


def test_a_search_for_nan_does_not_find_what_it_does_not_know_yet(name: str) -> None:
    with jax.debug_nans(True):
        state = jax.jit(TRAINER.init)(hyper := two_runs(name)[0])
        jax.jit(lambda hyper, state: hyper.curriculum.report(state))(hyper, state.curriculum)


@pytest.mark.slow
def test_a_search_for_nan_finds_none_in_training(name: str) -> None:
    hyper = two_runs(name)[0]
    with jax.debug_nans(True):
        state = jax.jit(TRAINER.init)(hyper)
        for _ in range(2):
            state, _ = jax.block_until_ready(jax.jit(TRAINER.epoch)(state, hyper))


def test_wrong_settings_are_refused_by_name(name: str) -> None:
    assert_wrong_settings_are_refused_by_name("curriculum", name)
