"""What every agent promises to the loop, for all that are discovered."""

import dataclasses
import math
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from cgm_jax.config.components import ROOMS, builtin, component
from cgm_jax.config.fields import SettingError, declared
from cgm_jax.config.grid import build_groups
from cgm_jax.host.checkpoint import TrainingProgress, load_checkpoint, save_checkpoint
from cgm_jax.loop.divergence import MAX_WEIGHT, describe_failure
from cgm_jax.measuring.compilations import programs_compiled
from tests.cgm_jax.agents.oracle import SIZES, example_batch
from tests.cgm_jax.agents.trained import AGENTS, bits, is_key, on_host, trained
from tests.cgm_jax.probe import tiny
from tests.cgm_jax.protocols import assert_no_type_is_promoted

EVERY = pytest.mark.parametrize("agent", AGENTS)


def test_the_agents_that_come_with_the_package() -> None:
    assert AGENTS == ["ddpg", "sac", "td3"]


@EVERY
def test_training_keeps_structure_shapes_and_types(agent: str) -> None:
    run = trained(agent)

    def abstract(tree: Any) -> Any:
        return jax.tree.map(lambda leaf: (leaf.shape, leaf.dtype), tree)

    assert abstract(run.start) == abstract(run.first) == abstract(run.second)
    shapes = jax.eval_shape(run.programs.start, run.hyper)
    assert not [leaf for leaf in jax.tree.leaves(shapes) if leaf.weak_type and not is_key(leaf)]
    assert run.compiled_later == 0


@EVERY
def test_no_type_is_promoted(agent: str) -> None:
    run = trained(agent)
    assert_no_type_is_promoted(run.programs.trainer, run.hyper)


@EVERY
def test_each_traced_setting_changes_its_own_run_beside_the_others(agent: str) -> None:
    run = trained(agent)

    def row(i: int) -> list[np.ndarray]:
        return [leaf[i] for leaf in bits(run.second.agent)]

    for i, name in enumerate(run.names[1:], start=1):
        differs = any((x != y).any() for x, y in zip(row(0), row(i), strict=True))
        assert differs, name
    assert all((leaf[0] == leaf[1]).all() for leaf in bits(run.start.agent.actor))


@EVERY
def test_a_learning_rate_that_diverges_freezes_its_run_and_is_named(agent: str) -> None:
    run = trained(agent)
    for i, name in enumerate(run.names):
        if not name.startswith("diverging"):
            assert run.failure[i] == 0, name
            continue
        part = name.removeprefix("diverging ").removesuffix("_learning_rate")
        assert part in describe_failure(int(run.failure[i]), run.second.agent)
        for leaf in bits(run.second.agent):
            assert np.isfinite(leaf[i]).all()
        assert run.second.updates[i] < run.second.updates[0] == 16
    assert sum(run.failure > 0) >= 1
    for field in dataclasses.fields(run.second.agent):
        if not field.name.endswith("optimiser"):
            leaves = bits(getattr(run.second.agent, field.name))
            assert all((np.abs(leaf) <= MAX_WEIGHT).all() for leaf in leaves)


def test_a_cycle_updates_the_actor_once_in_so_many_updates_of_the_critic() -> None:
    run = trained("td3")
    agent: Any = run.second.agent
    assert tiny(agent="td3").agent.actor_update_every == 2
    assert int(agent.updates[0]) == int(agent.critic_optimiser.count[0]) == 16
    assert int(agent.actor_optimiser.count[0]) == 8
    assert run.logged[0] == 4  # of both networks, in one of two epochs


@EVERY
def test_a_checkpoint_gives_every_bit_back_and_training_resumes_from_it(
    agent: str, tmp_path: Path
) -> None:
    run = trained(agent)
    save_checkpoint(tmp_path, 0, TrainingProgress(run.first, epoch=1))
    like = jax.eval_shape(run.programs.start, run.hyper)
    training, notes = load_checkpoint(tmp_path, 0, like)
    assert training is not None
    assert not notes
    assert jax.tree.structure(training.state) == jax.tree.structure(run.first)
    for x, y in zip(bits(training.state), bits(run.first), strict=True):
        np.testing.assert_array_equal(x, y)
    before = programs_compiled()
    state = run.programs.train(run.programs.spread(training.state), run.hyper, 2)
    state, _ = run.programs.evaluate(state, run.hyper)
    assert programs_compiled() == before > 0
    for x, y in zip(bits(on_host(state)), bits(run.second), strict=True):
        np.testing.assert_array_equal(x, y)


@EVERY
def test_three_critics_learn_side_by_side(agent: str) -> None:
    one = tiny(agent=agent, critics=3).agent
    state = one.init(jax.random.key(0), SIZES._replace(critics=3))
    state, info = jax.jit(one.train)(state, example_batch(4), jax.random.key(1))
    batch = example_batch()
    values = one.value(state, batch.inputs, batch.action)
    assert values.shape == (3, 16)
    for i in (1, 2):
        assert float(jnp.abs(values[i] - values[0]).max()) > 0.01
    assert set(info) == set(one.logged)
    assert len({value.shape for value in info.values()}) == 1
    assert all(bool(jnp.isfinite(value).all()) for value in info.values())


@EVERY
def test_actions_lie_within_their_limits_and_only_explorers_need_a_key(agent: str) -> None:
    one = tiny(agent=agent).agent
    state = one.init(jax.random.key(0), SIZES)
    inputs = 5.0 * example_batch().inputs
    first, second = (one.act(state, inputs, jax.random.key(i)) for i in (0, 1))
    assert first.shape == (16, SIZES.action)
    assert float(jnp.abs(first).max()) <= 1.0
    assert bool((first != second).any()) == one.explores
    again = one.act(state, inputs), one.act(state, inputs)
    np.testing.assert_array_equal(*again)


@EVERY
def test_wrong_settings_are_refused_in_one_line_that_starts_with_their_name(agent: str) -> None:
    for item in declared(component("agent", agent)):
        below = item.metadata["low"] - 1
        bad: list[Any] = ["much", None] + [below, math.nan] * (not isinstance(item.default, bool))
        if isinstance(item.default, tuple):
            bad = ["much", (), (below,)]
        for value in bad:
            with pytest.raises(SettingError, match=f"^{item.name}: ") as error:
                build_groups("smoke", {"agent": [agent], item.name: [value]})
            assert "\n" not in str(error.value)
    with pytest.raises(SettingError, match=f"^wings: is no setting of .*agent {agent}"):
        build_groups("smoke", {"agent": [agent], "wings": [2]})


@EVERY
def test_updates_that_come_in_no_whole_rounds_are_refused(agent: str) -> None:
    one = tiny(agent=agent, actor_update_every=5).agent
    with pytest.raises(SettingError, match=r"^actor_update_every: 5 does not divide .*, 12$"):
        one.init(jax.random.key(0), SIZES)


def test_options_that_components_share_agree_in_all_but_their_default() -> None:
    seen: dict[str, Any] = {}
    for kind in ROOMS:
        for found in builtin(kind).values():
            for item in declared(found):
                told = (type(item.default), dict(item.metadata))
                assert seen.setdefault(item.name, told) == told, (found, item.name)
    assert component("agent", "ddpg")().critics == 1
    assert component("agent", "td3")().critics == component("agent", "sac")().critics == 2


def test_a_setting_of_another_agent_is_refused_and_a_presets_is_not_missed() -> None:
    with pytest.raises(SettingError, match=r"^action_penalty: is no setting of .*agent sac"):
        build_groups("smoke", {"agent": ["sac"], "action_penalty": [0.5]})
    (group,) = build_groups("cpu", {"agent": ["sac"]}, single=True)
    values = group.runs[0].values
    assert (values["actor_update_every"], values["hidden_layers"]) == (2, (128, 128, 128))
    assert "evaluate_target" not in values
