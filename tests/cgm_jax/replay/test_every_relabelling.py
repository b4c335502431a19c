"""What the protocol asks of a way to relabel, asked of every one that comes with this package."""

import dataclasses
import functools
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from cgm_jax.config.components import builtin
from cgm_jax.config.fields import declared, stack
from cgm_jax.config.grid import hyperparameters
from cgm_jax.config.settings import Hyperparameters, Settings
from cgm_jax.envs import Stage
from cgm_jax.loop.state import TrainingState
from cgm_jax.loop.training import Programs, make_programs, make_trainer
from cgm_jax.measuring.compilations import programs_compiled
from cgm_jax.replay.protocol import Transitions
from cgm_jax.replay.ring import Replay
from tests.cgm_jax.protocols import (
    assert_no_type_is_promoted,
    assert_same,
    assert_training_resumes,
    assert_wrong_settings_are_refused_by_name,
    other_values,
)
from tests.examples.point_mass import PointMass


@dataclasses.dataclass(frozen=True)
class Staged(PointMass):
    """A point mass that is to be slow before it is at its goal, for what needs stages."""

    stages = (Stage(lambda observation: observation[2:], lambda *_: jnp.zeros(2), 2, 0.5),)


NAMES = sorted(builtin("relabelling"))
ENV, COUNT, CYCLES = Staged(), 400, 2
SETTINGS = Settings(
    env="probe",
    cycles_per_epoch=CYCLES,
    environments=8,
    updates_per_cycle=1,
    batch_size=64,
    replay_transitions=1000,
    evaluation_episodes=4,
)
AGENT = {"hidden_layers": (8,), "target_update_every": 1}


class Trained(NamedTuple):
    """Two epochs of two runs that differ in the seed and in every setting of the relabelling."""

    runs: list[Hyperparameters]
    programs: Programs
    start: Any  # the shapes of a state
    state: TrainingState
    compiled: list[int]  # programs, so far, after each epoch

    def replay(self, run: int = 0) -> Replay:
        """The ring of one run, 32 episodes of which are real; the others hold NaN."""
        replay = jax.tree.map(lambda leaf: leaf[run], self.state.replay)

        def unreal(rows: jax.Array) -> jax.Array:
            real = jnp.arange(len(rows)) < replay.inserted
            return jnp.where(real.reshape(-1, *[1] * (rows.ndim - 1)), rows, jnp.nan)

        return replay.replace(episodes=jax.tree.map(unreal, replay.episodes))


@functools.cache
def trained(name: str) -> Trained:
    runs = [
        hyperparameters(relabelling=name, curriculum="uniform", seed=0, **AGENT),
        hyperparameters(
            relabelling=name,
            curriculum="uniform",
            seed=1,
            **AGENT,
            **other_values("relabelling", name),
        ),
    ]
    programs, hyper = make_programs(make_trainer(ENV, SETTINGS)), stack(runs)
    state = programs.start(hyper)
    start = jax.eval_shape(lambda: state)
    compiled = []
    for _ in range(2):
        state, _ = programs.evaluate(programs.train(state, hyper, CYCLES), hyper)
        compiled.append(programs_compiled())
    return Trained(runs, programs, start, state, compiled)


@jax.jit
def sample(relabelling: Any, replay: Replay, key: jax.Array) -> Transitions:
    return relabelling.sample(key, replay, COUNT, ENV.distance_threshold, ENV.stages)


@pytest.fixture(params=NAMES)
def name(request: pytest.FixtureRequest) -> str:
    return request.param


def test_the_ways_that_come_with_the_package() -> None:
    assert {"future", "relay"} <= set(NAMES)


def test_it_compiles_once_and_the_state_keeps_its_shape(name: str) -> None:
    done = trained(name)
    assert done.compiled[1] == done.compiled[0] > 0
    end = jax.eval_shape(lambda: done.state)
    assert jax.tree.structure(end) == jax.tree.structure(done.start)
    for before, after in zip(*map(jax.tree.leaves, (done.start, end)), strict=True):
        assert (before.shape, before.dtype) == (after.shape, after.dtype)


@pytest.mark.parametrize("run", [0, 1])
def test_transitions_are_real_ones_with_their_goals_masked_and_rewards_recomputed(
    name: str, run: int
) -> None:
    done = trained(name)
    replay, relabelling = done.replay(run), done.runs[run].relabelling
    drawn = jax.tree.map(np.asarray, sample(relabelling, replay, jax.random.key(1)))
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(drawn))  # none of no episode
    episodes = jax.tree.map(np.asarray, replay.episodes)
    assert set(np.unique(drawn.mask)) <= {0.0, 1.0}
    own_goals = 0
    for i in range(COUNT):
        same = (episodes.observation[:, :-1] == drawn.observation[i]).all(axis=-1)
        (episode,), (step,) = np.nonzero(same)  # observations of a step tell it apart
        np.testing.assert_array_equal(drawn.action[i], episodes.action[episode, step])
        after = episodes.observation[episode, step + 1]
        np.testing.assert_array_equal(drawn.next_observation[i], after)
        # Masked dimensions follow what is achieved; the others are one goal at both steps.
        now, then = episodes.achieved_goal[episode, step], episodes.achieved_goal[episode, step + 1]
        kept = drawn.mask[i] > 0
        np.testing.assert_array_equal(drawn.goal[i][~kept], now[~kept])
        np.testing.assert_array_equal(drawn.next_goal[i][~kept], then[~kept])
        np.testing.assert_array_equal(drawn.goal[i][kept], drawn.next_goal[i][kept])
        distance = np.linalg.norm(drawn.next_goal[i] - then)
        if drawn.subgoal is None or not drawn.subgoal[i, 0]:
            assert drawn.reward[i] == (0.0 if distance < drawn.threshold[i] else -1.0)
        own = episodes.desired_goal[episode]
        own_goals += bool((drawn.goal[i] == np.where(kept, own, now)).all())
    assert own_goals > 0
    assert len(np.unique(drawn.observation, axis=0)) > COUNT // 4


def test_runs_with_other_settings_are_vmapped(name: str) -> None:
    done, key = trained(name), jax.random.key(2)
    hyper = stack(done.runs).relabelling
    together = jax.jit(jax.vmap(sample, in_axes=(0, 0, None)))(hyper, done.state.replay, key)
    for run in range(2):
        own = jax.tree.map(lambda leaf, i=run: leaf[i], (hyper, done.state.replay))
        assert_same(sample(*own, key), jax.tree.map(lambda leaf, i=run: leaf[i], together))
    differs = [(leaf[0] != leaf[1]).any() for leaf in jax.tree.leaves(together)]
    assert any(differs)


def test_what_it_draws_depends_on_its_key_alone_and_idle_settings_change_nothing(name: str) -> None:
    done = trained(name)
    replay, key = done.replay(), jax.random.key(3)
    for run in done.runs:
        drawn = sample(run.relabelling, replay, key)
        assert_same(sample(run.relabelling, replay, key), drawn)
        again = sample(run.relabelling, replay, jax.random.key(4))
        assert (again.observation != drawn.observation).any()
        idle = run.relabelling.idle()
        assert idle <= {item.name for item in declared(run.relabelling)}
        others = {n: v for n, v in other_values("relabelling", name).items() if n in idle}
        changed = dataclasses.replace(run.relabelling, **others)
        assert_same(sample(changed, replay, key), drawn)


def test_it_resumes_from_a_checkpoint(name: str, tmp_path: Path) -> None:
    done = trained(name)
    assert_training_resumes(done.programs, stack(done.runs), done.state, done.start, tmp_path)


def test_no_type_is_promoted(name: str) -> None:
    done = trained(name)
    assert_no_type_is_promoted(done.programs.trainer, stack(done.runs))


def test_wrong_settings_are_refused_by_name(name: str) -> None:
    assert_wrong_settings_are_refused_by_name("relabelling", name)
