import dataclasses
import functools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from cgm_jax.config.fields import declared, stack
from cgm_jax.config.settings import Hyperparameters
from cgm_jax.envs import GoalEnvironment
from cgm_jax.loop.evaluation import Metrics
from cgm_jax.loop.learning import minibatches
from cgm_jax.loop.state import TrainingState
from cgm_jax.loop.training import make_trainer
from cgm_jax.measuring.compilations import programs_compiled
from tests.cgm_jax.loop.programs import PROGRAMS
from tests.cgm_jax.probe import (
    TINY,
    AlwaysFaultyProbe,
    OneStepProbe,
    actor_that_needs_to_see_y,
    tiny,
)
from tests.examples.point_mass import PointMass

ENVIRONMENT = PointMass()


@functools.cache
def compiled(env: GoalEnvironment) -> tuple[Callable[..., Any], Callable[..., Any]]:
    """Jitted once, so that tests with the same number of runs share a compilation."""
    trainer = make_trainer(env, TINY)
    return jax.jit(jax.vmap(trainer.init)), jax.jit(jax.vmap(trainer.epoch))


def epochs(
    runs: list[Hyperparameters], count: int = 2, env: GoalEnvironment = ENVIRONMENT
) -> tuple[TrainingState, list[Metrics]]:
    """Train runs side by side; every leaf of the result has a leading axis of runs."""
    start, epoch = compiled(env)
    hyper, history = stack(runs), []
    state = start(hyper)
    for _ in range(count):
        state, metrics = epoch(state, hyper)
        history.append(metrics)
    return state, history


def bits(tree: Any) -> list[np.ndarray]:
    leaves = [
        jax.random.key_data(leaf) if jnp.issubdtype(leaf.dtype, jax.dtypes.prng_key) else leaf
        for leaf in jax.tree.leaves(tree)
    ]
    return [np.asarray(leaf) for leaf in leaves]


def test_the_same_seed_repeats_bit_for_bit_and_another_differs() -> None:
    state, _ = epochs([tiny(seed=3), tiny(seed=3), tiny(seed=4)])
    again, _ = epochs([tiny(seed=3), tiny(seed=3), tiny(seed=4)])
    for leaf, repeated in zip(bits(state), bits(again), strict=True):
        np.testing.assert_array_equal(leaf, repeated)
        np.testing.assert_array_equal(leaf[0], leaf[1])
    for part in (state.agent.actor, state.replay.episodes, state.normaliser.goal.mean):
        assert any((leaf[0] != leaf[2]).any() for leaf in bits(part))


@dataclasses.dataclass(frozen=True)
class Rescaled(PointMass):
    """The point mass in another unit, and around another origin."""

    unit: float = 1.0
    origin: float = 0.0
    distance_threshold: float = 0.1

    def reset(self, rng: jax.Array) -> Any:
        position, goal = jax.random.uniform(rng, (2, 2), minval=-1.0, maxval=1.0)
        position, goal = (self.origin + self.unit * place for place in (position, goal))
        return self._state(position, jnp.zeros(2), goal)

    def step(self, state: Any, action: jax.Array) -> Any:
        position, velocity = jnp.split(state.obs["observation"], 2)
        velocity = 0.7 * velocity + 0.5 * self.unit * action
        return self._state(position + 0.1 * velocity, velocity, state.obs["desired_goal"])


@pytest.mark.parametrize(("curriculum", "unit"), [("cgm", 2.0**10), ("mega", 2.0**-17)])
def test_the_unit_of_a_task_changes_no_bit_of_training(curriculum: str, unit: float) -> None:
    # Powers of two, so that float32 scales exactly: about millimetres, and about 1e-5.
    hyper = tiny(seed=5, curriculum=curriculum)
    _, expected = epochs([hyper], env=Rescaled())
    _, metrics = epochs([hyper], env=Rescaled(unit=unit, distance_threshold=0.1 * unit))
    for one, other in zip(metrics, expected, strict=True):
        for name in ("success_rate", "subgoal_success", "critic_loss", "actor_loss", "value"):
            np.testing.assert_array_equal(one[name], other[name], name)


def test_a_task_far_from_the_origin_trains_alike() -> None:
    # Float32 resolves 3e-5 there, so alike only as far as rounding lets trajectories agree.
    _, expected = epochs([tiny(seed=5)], 1, Rescaled())
    state, metrics = epochs([tiny(seed=5)], 1, Rescaled(origin=500.0))
    np.testing.assert_allclose(metrics[0]["critic_loss"], expected[0]["critic_loss"], rtol=0.05)
    spread = np.asarray(state.replay.episodes.desired_goal[0, :16]).std(0)
    statistics: Any = state.normaliser.goal
    assert (np.asarray(statistics.std[0]) < 3 * spread).all()


def test_a_run_among_others_equals_the_run_alone() -> None:
    runs = [
        tiny(seed=0, c_g=0.8, kappa=1.0),
        tiny(seed=1, c_g=0.1, kappa=32.0),
        tiny(seed=2, full_share=1.0, her=False, action_noise=0.5),
    ]
    together, together_metrics = epochs(runs)
    for i, run in enumerate(runs):
        alone, alone_metrics = epochs([run])
        for leaf, single in zip(bits(together), bits(alone), strict=True):
            # Matrix products of another shape may differ in the last bits; nothing else does.
            np.testing.assert_allclose(leaf[i], single[0], rtol=2e-4, atol=2e-5)
        for one, other in zip(together_metrics, alone_metrics, strict=True):
            np.testing.assert_allclose(
                one["mask_probability"][i], other["mask_probability"][0], rtol=1e-4
            )


def test_hyperparameters_that_a_sweep_varies_change_the_run() -> None:
    base = tiny(c_g=0.4, kappa=1.0)
    changes: dict[str, Any] = {
        "c_g": 0.9,
        "kappa": 30.0,
        "full_share": 1.0,
        "her": False,
        "her_k": 1.0,
        "actor_learning_rate": 1e-4,
        "critic_learning_rate": 1e-4,
        "discount": 0.5,
        "target_rate": 0.5,
        "action_penalty": 0.0,
        "action_noise": 0.0,
        "random_action_probability": 0.9,
        "random_action_steps": 7,
        "seed": 1,
    }
    # No effect within this short run: tested elsewhere.
    later = {"her_filter", "her_masks"}
    instances = [base, base.curriculum, base.agent, base.relabelling]
    fields = [item for instance in instances for item in declared(instance)]
    assert {*changes, *later} == {item.name for item in fields if item.metadata["traced"]}
    names = [*changes]
    for pair in zip(names[::2], names[1::2], strict=True):  # three runs, as other tests have
        changed = [tiny(**{"c_g": 0.4, "kappa": 1.0, name: changes[name]}) for name in pair]
        state, _ = epochs([base, *changed], count=1)
        for i, name in enumerate(pair, start=1):
            assert any((leaf[i] != leaf[0]).any() for leaf in bits(state.agent.actor)), name


def test_sampled_goals_change_after_every_reset() -> None:
    state, _ = epochs([tiny(seed=i) for i in range(3)])
    goals = np.asarray(state.replay.episodes.desired_goal[0, : int(state.replay.inserted[0])])
    assert len(goals) == 2 * TINY.cycles_per_epoch * TINY.environments
    assert len(np.unique(goals, axis=0)) == len(goals)


def test_training_compiles_once_however_it_is_cut_into_chunks() -> None:
    programs = PROGRAMS
    compiled = []
    for values in ((0.1, 0.2, 0.3), (0.6, 0.9, 0.4)):
        hyper = stack([tiny(c_g=c_g) for c_g in values])
        state = programs.start(hyper)
        for chunks in ((4,), (1, 3, 2)):
            for cycles in chunks:
                state = programs.train(state, hyper, cycles)
            state, _ = programs.evaluate(state, hyper)
            compiled.append(programs_compiled())
    # Start, train and evaluate, whatever the values and the number of cycles.
    assert compiled[1:] == compiled[:1] * 3


def test_chunks_give_the_bits_of_one_epoch() -> None:
    programs = PROGRAMS
    hyper = stack([tiny(seed=5)] * 3)
    whole = programs.train(programs.start(hyper), hyper, 4)
    cut = programs.start(hyper)
    for cycles in (1, 2, 1):
        cut = programs.train(cut, hyper, cycles)
    for leaf, other in zip(bits(whole), bits(cut), strict=True):
        np.testing.assert_array_equal(leaf, other)


def test_metrics_count_steps_updates_and_masks() -> None:
    runs = [tiny(c_g=0.5, kappa=1.0), tiny(), tiny(seed=1)]
    state, history = epochs(runs)
    metrics = history[-1]
    np.testing.assert_array_equal(metrics["env_steps"], 2 * 2 * 8 * 25)
    np.testing.assert_array_equal(metrics["updates"], 2 * 2 * 4)
    np.testing.assert_allclose(metrics["mask_share"].sum(1), 1.0)
    np.testing.assert_array_equal(metrics["moved_share"], 1.0)  # a force always moves the point
    masks = np.asarray(state.replay.episodes.mask[0, : int(state.replay.inserted[0])])
    assert masks.min() == 0.0


def test_the_curriculum_follows_the_sub_goal_history() -> None:
    state, history = epochs([tiny(c_g=0.3)], count=1)
    np.testing.assert_allclose(history[0]["mask_rate_estimated"][0, -1], 0.3, rtol=1e-5)
    known = jax.tree.map(lambda leaf: leaf[0], state.curriculum)
    successes = np.asarray(known.subgoals.successes)
    rates = tiny().curriculum.rates(known)
    expected = [1.0, successes[:, 1].mean(), successes[:, 0].mean(), successes.mean(0).prod()]
    np.testing.assert_allclose(rates, expected, rtol=1e-5)


def test_an_evaluation_without_a_valid_episode_has_no_success_rate() -> None:
    trainer = make_trainer(AlwaysFaultyProbe((1.0,)), TINY)
    state = trainer.init(tiny())
    state, metrics = jax.jit(trainer.evaluate)(state, tiny())
    assert np.isnan(float(metrics["success_rate"]))
    assert int(state.curriculum.subgoals.count) == 0


def test_without_an_episode_to_learn_from_the_agent_stays_as_it_was() -> None:
    trainer = make_trainer(AlwaysFaultyProbe((1.0,)), TINY)
    first = trainer.init(tiny())
    state = jax.jit(trainer.train)(first, tiny(), 1)
    assert int(state.replay.inserted) == int(state.updates) == 0
    assert float(state.statistics.updates) == 0
    assert set(state.statistics.losses) == {"critic_loss", "actor_loss", "value"}
    for total in state.statistics.losses.values():
        assert float(total) == 0.0
    for one, other in zip(bits(state.agent), bits(first.agent), strict=True):
        np.testing.assert_array_equal(one, other)


def test_the_filter_decides_which_episodes_are_relabelled() -> None:
    state, _ = epochs([tiny()], count=1)
    state = jax.tree.map(lambda leaf: leaf[0], state)
    episodes = state.replay.episodes
    still = episodes.achieved_goal.at[1:].set(episodes.achieved_goal[1:, :1])  # all but the first
    state = state.replace(
        replay=state.replay.replace(episodes=episodes.replace(achieved_goal=still))
    )
    assert int(state.replay.inserted) == 16
    for her_filter in (False, True):
        hyper = tiny(her_k=6.0, her_filter=her_filter, curriculum="full")
        rewards = minibatches(PROGRAMS.trainer.setup, state, hyper, jax.random.key(0)).reward
        # Hindsight goals of episodes that stood still are achieved throughout.
        achieved = float((rewards == 0).mean())
        assert (achieved > 0.75) != her_filter


def test_masks_are_judged_by_product_or_joint_rate() -> None:
    state = PROGRAMS.trainer.init(tiny()).curriculum
    # Two sub-goals that succeed together in half of the rollouts, and never alone.
    history = state.subgoals.replace(
        successes=jnp.tile(jnp.array([[0.0, 0.0], [1.0, 1.0]]), (5, 1)),
        count=jnp.asarray(10, jnp.int32),
    )
    state = state.replace(subgoals=history)
    product = tiny(factorised=True).curriculum.rates(state)
    joint = tiny(factorised=False).curriculum.rates(state)
    np.testing.assert_allclose(product, [1.0, 0.5, 0.5, 0.25])
    np.testing.assert_allclose(joint, [1.0, 0.5, 0.5, 0.5])


def test_measured_masks_are_judged_by_episodes_with_their_own_masked_goal() -> None:
    """A policy that needs to see y to achieve x: with y masked x fails, which no estimate knows."""
    trainer = make_trainer(OneStepProbe((1.0,), goal_size=2, action_size=2), TINY)
    measured = tiny(masked_evaluation_episodes=3)
    state = trainer.init(measured)
    actor = actor_that_needs_to_see_y(state.agent.actor)
    state = state.replace(agent=state.agent.replace(actor=actor))
    before = tiny(c_g=0.25).curriculum.rates(state.curriculum)
    np.testing.assert_allclose(before, [1.0, 0.5, 0.5, 0.25])
    state, metrics = jax.jit(trainer.evaluate)(state, measured)
    assert float(metrics["success_rate"]) == 1.0
    assert state.curriculum.masks.inserted.tolist() == [3, 3, 3, 3]
    rates = measured.curriculum.rates(state.curriculum)
    np.testing.assert_array_equal(rates, [1.0, 1.0, 0.0, 1.0])


def test_episodes_of_measured_masks_with_broken_physics_are_counted() -> None:
    trainer = make_trainer(AlwaysFaultyProbe((1.0,)), TINY)
    measured = tiny(masked_evaluation_episodes=3)
    state, metrics = jax.jit(trainer.evaluate)(trainer.init(measured), measured)
    assert float(metrics["physics_warnings"]) == TINY.evaluation_episodes + 2 * 3
    assert state.curriculum.masks.inserted.tolist() == [0, 0]


def test_the_evaluated_actor_is_the_one_that_the_settings_name() -> None:
    state, _ = epochs([tiny()], count=1)
    for evaluate_target, expected in (
        (True, state.agent.target_actor),
        (False, state.agent.actor),
    ):
        chosen = tiny(evaluate_target=evaluate_target).agent.actor(state.agent)
        for leaf, same in zip(bits(chosen), bits(expected), strict=True):
            np.testing.assert_array_equal(leaf, same)
    pairs = zip(bits(state.agent.actor), bits(state.agent.target_actor), strict=True)
    assert any((one != other).any() for one, other in pairs)


def test_evaluation_plays_the_target_actor_where_the_settings_say_so() -> None:
    """A target actor that pushes one way only cannot achieve what the actor achieves."""
    success = {}
    for evaluate_target in (False, True):
        trainer, hyper = (
            make_trainer(OneStepProbe(goals=(1.0,)), TINY),
            tiny(evaluate_target=evaluate_target),
        )
        state = trainer.init(hyper)
        actors = [jax.tree.map(jnp.zeros_like, state.agent.actor) for _ in range(2)]
        for actor, bias in zip(actors, (1.0, -1.0), strict=True):
            actor["params"]["layer_2"]["bias"] += bias
        agent = state.agent.replace(actor=actors[0], target_actor=actors[1])
        _, metrics = trainer.evaluate(state.replace(agent=agent), hyper)
        success[evaluate_target] = float(metrics["success_rate"])
    assert success == {False: 1.0, True: 0.0}
