import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from cgm_jax.agents.ddpg import DDPGState
from cgm_jax.config.fields import stack
from cgm_jax.loop.divergence import describe_failure, failure_of, freeze_if_failed
from tests.cgm_jax.loop.programs import PROGRAMS
from tests.cgm_jax.probe import TINY, tiny

NAMES = [item.name for item in dataclasses.fields(DDPGState)]
ACTOR, CRITIC = (1 << NAMES.index(name) for name in ("actor", "critic"))


def agent() -> DDPGState:
    return PROGRAMS.trainer.init(tiny()).agent


def spoilt(part: str, value: float) -> DDPGState:
    """The agent with one bias, or one running mean of a gradient, replaced."""
    whole = agent()

    def spoil(path: Any, leaf: jax.Array) -> jax.Array:
        return leaf.at[0].set(value) if "layer_1']['bias" in jax.tree_util.keystr(path) else leaf

    tree = jax.tree_util.tree_map_with_path(spoil, getattr(whole, part))
    return whole.replace(**{part: tree})


@pytest.mark.parametrize(
    ("part", "value", "fails"),
    [
        ("actor", 0.5, False),
        ("actor", jnp.nan, True),
        ("target_actor", -jnp.inf, True),
        ("critic", -2e9, True),
        ("target_critic", jnp.nan, True),
        ("critic", 0.9e9, False),
        ("critic_optimiser", 2e9, False),  # squares of gradients may be large
        ("actor_optimiser", jnp.inf, True),
    ],
)
def test_what_has_diverged_is_named(part: str, value: float, fails: bool) -> None:
    state = spoilt(part, value)
    failure = int(failure_of(state))
    assert (failure != 0) == fails
    if fails:
        assert describe_failure(failure, state) == f"{part} not finite or beyond 1e+09"


def test_several_failures_are_named_in_order() -> None:
    words = describe_failure(ACTOR | CRITIC, agent())
    assert words == "actor, critic not finite or beyond 1e+09"


def test_a_failed_run_stays_as_it_was_for_good() -> None:
    finite, bad, later = agent(), spoilt("critic", jnp.nan), spoilt("actor", 0.5)
    learned = jnp.asarray(True)
    failure, kept = freeze_if_failed(jnp.int32(0), finite, later, learned)
    assert int(failure) == 0
    assert kept.actor["params"]["layer_1"]["bias"][0] == 0.5
    for first, second in ((bad, later), (later, bad)):
        failure, kept = freeze_if_failed(jnp.int32(0), finite, first, learned)
        failure, kept = freeze_if_failed(failure, kept, second, learned)
        assert int(failure) == CRITIC
    assert kept.actor["params"]["layer_1"]["bias"][0] == 0.5  # the last finite one


def test_without_anything_to_learn_from_nothing_is_taken_and_nothing_fails() -> None:
    finite, bad, later = agent(), spoilt("critic", jnp.nan), spoilt("actor", 0.5)
    for new in (bad, later):
        failure, kept = freeze_if_failed(jnp.int32(0), finite, new, jnp.asarray(False))
        assert int(failure) == 0
        for one, other in zip(jax.tree.leaves(kept), jax.tree.leaves(finite), strict=True):
            np.testing.assert_array_equal(one, other)


def test_a_failed_run_logs_no_losses() -> None:
    hyper = stack([tiny(), tiny(critic_learning_rate=1e30), tiny()])
    state = PROGRAMS.train(PROGRAMS.start(hyper), hyper, 2)
    totals = {name: np.array(total) for name, total in state.statistics.losses.items()}
    # The last one fails with finite losses, which alone keep it from being as the first one.
    state = state.replace(failure=PROGRAMS.spread(np.asarray(state.failure) | [0, 0, CRITIC]))
    _, metrics = PROGRAMS.evaluate(state, hyper)
    assert metrics["failure"][0] == 0
    assert metrics["failure"][1] & CRITIC
    for name, total in totals.items():
        assert total[0] == total[2] != 0.0
        assert metrics[name][0] == pytest.approx(total[0] / (2 * TINY.updates_per_cycle))
        assert np.isnan(metrics[name][1:]).all()


@pytest.mark.parametrize("name", ["actor_learning_rate", "critic_learning_rate"])
def test_a_run_that_diverges_leaves_the_bits_of_the_others_alone(name: str) -> None:
    def train(rate: float) -> tuple[Any, Any]:
        hyper = stack([tiny(seed=i, **{name: rate if i == 1 else 1e-3}) for i in range(3)])
        state = PROGRAMS.train(PROGRAMS.start(hyper), hyper, 2)
        state, _ = PROGRAMS.evaluate(state, hyper)
        state = PROGRAMS.train(state, hyper, 3)
        return PROGRAMS.evaluate(state, hyper)

    (good, good_metrics), (bad, metrics) = train(1e-3), train(1e30)
    assert np.asarray(good_metrics["failure"]).tolist() == [0, 0, 0]
    failures = np.asarray(metrics["failure"])
    assert failures[[0, 2]].tolist() == [0, 0]
    assert failures[1] & (ACTOR if name.startswith("actor") else CRITIC)
    for leaf, other in zip(jax.tree.leaves(good), jax.tree.leaves(bad), strict=True):
        assert bool((leaf[::2] == other[::2]).all())
    for leaf in jax.tree.leaves(bad.agent):
        assert bool(jnp.isfinite(leaf).all())
    # The failing updates are not counted: the run stands where it was before them.
    assert int(metrics["updates"][1]) < int(metrics["updates"][0]) == 5 * TINY.updates_per_cycle
