"""Cycles that are cut give what whole ones would, wherever they are cut."""

import dataclasses
import functools
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from brax.envs.base import State

from cgm_jax import envs
from cgm_jax.config.components import builtin
from cgm_jax.config.fields import SettingError, stack
from cgm_jax.config.grid import build_groups
from cgm_jax.config.settings import Hyperparameters, Settings
from cgm_jax.host.checkpoint import TrainingProgress, load_checkpoint, save_checkpoint
from cgm_jax.loop import cutting, learning
from cgm_jax.loop.cutting import WHOLE, Parts, is_cut, updates_at_once
from cgm_jax.loop.cycle import carry_out, plan, store
from cgm_jax.loop.learning import learn_part
from cgm_jax.loop.rollout import roll_out
from cgm_jax.loop.state import TrainingState
from cgm_jax.loop.training import Trainer, make_programs, make_trainer
from tests.cgm_jax.probe import TINY, tiny
from tests.cgm_jax.protocols import assert_same
from tests.examples.point_mass import PointMass


@dataclasses.dataclass(frozen=True)
class Walled(PointMass):
    """Whose episodes end at a wall."""

    def is_terminal(self, state: State) -> jax.Array:
        return jnp.abs(state.obs["observation"][:2]).max() > 1.2  # pyright: ignore


@dataclasses.dataclass(frozen=True)
class HalfTold(PointMass):
    """Whose states do not hold all that there is of an episode, as a Gymnasium environment's."""

    states_are_whole: bool = False


@pytest.fixture
def cut_small(monkeypatch: pytest.MonkeyPatch) -> None:
    """Cut all cycles, into steps and into pairs of updates."""
    monkeypatch.setattr(cutting, "WHOLE_STEPS", 0)
    monkeypatch.setattr(cutting, "PART_TRANSITIONS", 2 * TINY.batch_size)


@pytest.mark.parametrize(
    ("environments", "updates", "batch_size", "platform", "cut"),
    [
        (512, 40, 512, "cpu", False),  # 25,600 environment steps
        (513, 40, 512, "cpu", True),
        (4096, 40, 512, "cpu", True),
        (4096, 40, 512, "gpu", False),
        (16, 128, 1024, "cpu", False),  # 131,072 transitions to learn from
        (16, 129, 1024, "cpu", True),
    ],
)
def test_which_cycles_are_cut(
    environments: int, updates: int, batch_size: int, platform: str, cut: bool
) -> None:
    settings = Settings(environments=environments, updates_per_cycle=updates, batch_size=batch_size)
    assert is_cut(envs.make("push", engine="native"), settings, platform) is cut


def test_physics_that_xla_compiles_are_cut_sooner() -> None:
    native, mjx = (envs.make("push", engine=engine) for engine in ("native", "mjx"))
    few, more = Settings(environments=16), Settings(environments=17)  # a step counts for 32
    assert not is_cut(mjx, few, "cpu")
    assert is_cut(mjx, more, "cpu")
    assert not is_cut(native, more, "cpu")


@pytest.mark.parametrize(
    ("updates", "batch_size", "every", "at_once"),
    [
        (640, 1024, 2, 32),
        (800, 1024, 2, 32),
        (640, 1024, 5, 20),  # the largest that five divides
        (640, 1024, 640, 640),  # the actor learns once a cycle
        (7, 16_384, 1, 1),  # a prime number of large ones
        (40, 512, 1, 40),
        (3, 65_536, 1, 1),  # not even one is short
        (640, 1024, 40, 40),  # the fewest that the agent takes are a little too many
    ],
)
def test_updates_are_cut_evenly_where_the_agent_lets_them(
    updates: int, batch_size: int, every: int, at_once: int
) -> None:
    asked = []

    def check(count: int) -> None:
        asked.append(count)
        if count % every:
            raise SettingError("not in whole rounds")

    settings = Settings(updates_per_cycle=updates, batch_size=batch_size)
    assert updates_at_once(settings, check) == at_once
    assert all(updates % count == 0 for count in asked)


def test_preset_gpu_is_cut_on_a_cpu_as_its_agent_can_be() -> None:
    (group,) = build_groups("gpu", {"env": ["push"], "engine": ["native"]})
    env = envs.make("push", engine="native")
    for platform, parts in (("cpu", Parts(rollout=50, updates=20)), ("gpu", WHOLE)):
        trainer = make_trainer(env, group.settings, platform)
        assert trainer.parts(group.runs[0].hyper) == parts
        state = jax.eval_shape(trainer.init, group.runs[0].hyper)
        assert (state.unfinished is None) is (parts == WHOLE)


@functools.cache
def cut(env: PointMass) -> tuple[Trainer, Callable[..., TrainingState]]:
    """A trainer, and its compiled `train`; to be called where `cut_small` is used."""
    trainer = make_trainer(env, TINY)
    return trainer, jax.jit(trainer.train)


CASES = {
    "ddpg and starts": (PointMass(), tiny(curriculum="starts")),
    "sac, starts and episodes that end": (Walled(), tiny(agent="sac", curriculum="starts")),
    "whole rollouts": (HalfTold(), tiny()),
    "td3 and episodes that end": (Walled(), tiny(agent="td3", critics=2)),
}
*QUICK, LONG = CASES


@pytest.mark.usefixtures("cut_small")
@pytest.mark.parametrize("case", [*QUICK, pytest.param(LONG, marks=pytest.mark.slow)])
def test_a_cycle_in_parts_is_a_rollout_and_its_updates(case: str) -> None:
    env, hyper = CASES[case]
    trainer, train = cut(env)
    parts = trainer.parts(hyper)
    assert parts == Parts(rollout=1 if env == HalfTold() else 25, updates=2)
    start = trainer.init(hyper)
    halfway = train(start, hyper, parts.rollout)
    assert (int(halfway.unfinished.done), int(halfway.env_steps)) == (parts.rollout, 8 * 25)
    assert int(halfway.updates) == 0
    after = train(train(halfway, hyper, 1), hyper, parts.total)  # far into the next cycle
    after = train(after, hyper, parts.total - parts.rollout - 1)
    assert int(after.unfinished.done) == 0
    reference = jax.jit(lambda state: whole_cycle(trainer, state, hyper, parts))
    expected = reference(reference(start))
    assert int(after.updates) == int(expected.updates) == 2 * TINY.updates_per_cycle
    assert_close(after.replace(unfinished=None), expected.replace(unfinished=None))


def whole_cycle(
    trainer: Trainer, state: TrainingState, hyper: Hyperparameters, parts: Parts
) -> TrainingState:
    """What the parts of a cycle come to: its rollout in one scan, then its updates."""
    setup = trainer.setup
    planned = plan(setup, state, hyper)
    state = store(setup, state, hyper, carry_out(setup, state, hyper, planned, roll_out))
    for index in range(parts.updates):
        state = learn_part(setup, state, hyper, planned.draw_key, planned.agent_key, index)
    return state.replace(key=planned.key)


def assert_close(one: Any, other: Any) -> None:
    """Two pytrees agree up to rounding."""
    assert jax.tree.structure(one) == jax.tree.structure(other)
    for leaf, alike in zip(jax.tree.leaves(one), jax.tree.leaves(other), strict=True):
        if jnp.issubdtype(leaf.dtype, jax.dtypes.prng_key):
            assert (leaf == alike).all()
        else:
            np.testing.assert_allclose(leaf, alike, rtol=1e-3, atol=1e-4)


@pytest.mark.usefixtures("cut_small")
@pytest.mark.slow
def test_bits_do_not_depend_on_where_a_cycle_was_stopped(tmp_path: Path) -> None:
    trainer = make_trainer(PointMass(), TINY)
    programs, hyper = make_programs(trainer), stack([tiny(seed=0), tiny(seed=1)])
    parts = trainer.parts(tiny())
    whole = programs.train(programs.start(hyper), hyper, 2 * parts.total)
    state, done = programs.start(hyper), 0
    like = jax.eval_shape(jax.vmap(trainer.init), hyper)
    for count in (1, 9, 15, 1, 1, parts.total - 20, 20):
        state, done = programs.train(state, hyper, count), done + count
        cycle, part = divmod(done, parts.total)
        save_checkpoint(tmp_path, 0, TrainingProgress(state, cycle=cycle, part=part, runs=2))
        training, notes = load_checkpoint(tmp_path, 0, like)
        assert training is not None
        assert not notes
        assert (training.cycle, training.part) == (cycle, part)
        state = programs.spread(training.state)
    assert done == 2 * parts.total
    assert_same(state.replace(unfinished=None), whole.replace(unfinished=None))
    alone = stack([tiny(seed=1)])
    state = programs.train(programs.start(alone), alone, 2 * parts.total)
    assert_same(state, jax.tree.map(lambda leaf: leaf[1:], whole))


@pytest.mark.usefixtures("cut_small")
def test_a_device_that_does_not_cut_goes_on_between_cycles_but_not_within_one(
    tmp_path: Path,
) -> None:
    cutting_trainer, hyper = make_trainer(PointMass(), TINY), stack([tiny()])
    state = jax.eval_shape(jax.vmap(cutting_trainer.init), hyper)
    state = jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), state)
    like = jax.eval_shape(jax.vmap(make_trainer(PointMass(), TINY, "gpu").init), hyper)
    save_checkpoint(tmp_path, 0, TrainingProgress(state, epoch=1))
    training, _ = load_checkpoint(tmp_path, 0, like)
    assert training is not None
    assert training.state.unfinished is None
    save_checkpoint(tmp_path, 1, training)
    training, _ = load_checkpoint(tmp_path, 1, jax.eval_shape(lambda: state))
    assert training is not None
    assert_same(training.state, state)  # with nothing unfinished
    save_checkpoint(tmp_path, 0, TrainingProgress(state, epoch=1, part=3))
    with pytest.raises(SettingError, match="middle of a cycle that was cut"):
        load_checkpoint(tmp_path, 0, like)


@pytest.mark.slow
@pytest.mark.usefixtures("cut_small", "strict")
@pytest.mark.parametrize(
    "values",
    [
        *({"curriculum": name, "critics": 3} for name in builtin("curriculum")),
        *({"agent": name} for name in builtin("agent")),
    ],
    ids=lambda values: " ".join(map(str, values.values())),
)
def test_every_part_keeps_the_structure_of_the_state(values: dict[str, Any]) -> None:
    trainer = make_trainer(PointMass(), TINY)
    hyper = jax.tree.map(lambda leaf: leaf[0], stack([tiny(**values)]))
    state = jax.eval_shape(trainer.init, hyper)
    trained = jax.eval_shape(trainer.train, state, hyper, 1)
    after_epoch, _ = jax.eval_shape(trainer.epoch, state, hyper)
    shapes = [(leaf.shape, leaf.dtype) for leaf in jax.tree.leaves(state)]
    for after in (trained, after_epoch):
        assert jax.tree.structure(after) == jax.tree.structure(state)
        assert [(leaf.shape, leaf.dtype) for leaf in jax.tree.leaves(after)] == shapes


@pytest.mark.usefixtures("cut_small")
def test_an_epoch_is_as_many_parts_as_its_cycles_have() -> None:
    (trainer, train), hyper = cut(PointMass()), tiny(curriculum="starts")
    epoch = jax.jit(trainer.epoch)
    start = trainer.init(hyper)
    expected = train(start, hyper, TINY.cycles_per_epoch * trainer.parts(hyper).total)
    for begun in (0, 3):  # a cycle that has begun is the epoch's first
        state, metrics = epoch(train(start, hyper, begun), hyper)
        assert int(metrics["env_steps"]) == TINY.cycles_per_epoch * 8 * 25
        assert int(metrics["updates"]) == TINY.cycles_per_epoch * TINY.updates_per_cycle
        assert int(state.unfinished.done) == 0
        assert_close(state.agent, expected.agent)
        assert_close(state.replay, expected.replay)


@pytest.mark.usefixtures("cut_small")
def test_a_run_that_diverges_in_one_part_learns_in_none_that_follows() -> None:
    trainer, train = cut(PointMass())
    hyper = tiny(curriculum="starts", critic_learning_rate=1e30)
    parts = trainer.parts(hyper)
    before = train(trainer.init(hyper), hyper, parts.rollout)
    failed = train(before, hyper, 1)
    assert int(failed.failure) != 0
    assert_same(failed.agent, before.agent)
    later = train(failed, hyper, 2 * parts.total)
    assert_same(later.agent, before.agent)
    assert int(later.updates) == 0


def test_each_part_of_a_cycles_updates_draws_anew(monkeypatch: pytest.MonkeyPatch) -> None:
    keys: list[tuple[jax.Array, ...]] = []

    def learn(setup: Any, state: Any, hyper: Any, *drawn: jax.Array) -> Any:
        keys.append(drawn)
        return state

    monkeypatch.setattr(learning, "learn", learn)
    trainer, hyper = make_trainer(PointMass(), TINY), tiny()
    state = trainer.init(hyper)
    for index in range(3):
        learn_part(trainer.setup, state, hyper, jax.random.key(0), jax.random.key(1), index)
    for of_parts in zip(*keys, strict=True):
        assert len({jax.random.key_data(key).tobytes() for key in of_parts}) == 3
