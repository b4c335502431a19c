import jax
import jax.numpy as jnp
import numpy as np
import pytest

from cgm_jax.curricula.accuracy import Accuracy, AccuracyState
from cgm_jax.curricula.protocol import Goals, Outcomes
from cgm_jax.loop.inputs import network_inputs
from cgm_jax.loop.training import make_trainer
from tests.cgm_jax.curricula.small import SMALL, Distances, epochs, sizes
from tests.cgm_jax.probe import tiny


def after(
    curriculum: Accuracy, state: AccuracyState, thresholds: jax.Array, success: list[int]
) -> AccuracyState:
    count = len(success)
    goals = Goals(jnp.zeros((count, 1)), jnp.ones((count, 1)), thresholds)
    outcomes = Outcomes(
        goals=goals,
        success=jnp.array(success, bool),
        subgoal_success=jnp.zeros((count, 1), bool),  # at the environment's own threshold
        valid=jnp.ones(count, bool),
        observation=jnp.zeros((count, 1)),
    )
    return curriculum.after_training(state, outcomes)


def test_the_ladder_is_even_and_starts_at_the_environments_own() -> None:
    # The paper's accuracies for a target of 0.02.
    state = Accuracy().init(sizes(1, distance_threshold=0.02))
    np.testing.assert_allclose(state.thresholds, [0.02, 0.03, 0.04, 0.05], rtol=1e-6)


@pytest.mark.parametrize("exponent", [0.0, 1.0, 4.0])
def test_probabilities_by_hand(exponent: float) -> None:
    curriculum = Accuracy(
        threshold_steps=3, progress_window=4, progress_floor=0.1, progress_exponent=exponent
    )
    state = curriculum.init(sizes(1))
    np.testing.assert_allclose(curriculum.probabilities(state), 1 / 3, rtol=1e-6)
    for success in ([0, 0, 1], [0, 1, 1], [0, 0, 0], [0, 0, 0]):
        state = after(curriculum, state, state.thresholds, success)
    report = curriculum.report(state)
    np.testing.assert_allclose(report["threshold_progress"], [0, -0.5, -1])
    np.testing.assert_allclose(report["threshold_rate_training"], [0, 0.25, 0.5])
    weights = np.array([0.1, 0.6, 1.1]) ** exponent
    np.testing.assert_allclose(report["threshold_probability"], weights / weights.sum(), rtol=1e-5)


def test_networks_see_the_threshold_and_of_the_environments_own_nothing() -> None:
    trainer, hyper = make_trainer(Distances(), SMALL), tiny(curriculum="accuracy")
    state = trainer.init(hyper)
    assert state.agent.actor["params"]["layer_0"]["kernel"].shape[0] == 1 + 1 + 1
    inputs = network_inputs(
        trainer.setup,
        hyper,
        state.normaliser,
        jnp.zeros((2, 1)),
        jnp.zeros((2, 1)),
        jnp.ones((2, 1)),
        jnp.array([0.1, 0.25]),
    )
    np.testing.assert_allclose(inputs[:, -1], [0, np.log(2.5)], rtol=1e-6)


def test_training_practises_thresholds_whose_success_changes() -> None:
    # Episodes end at 0.15 or 0.25: never within 0.1, within 0.2 by chance, always within 0.3.
    hyper = tiny(
        curriculum="accuracy", threshold_steps=3, threshold_widest=3.0, progress_floor=1e-3
    )
    run = epochs(Distances(), hyper)
    (_, first), (state, second) = next(run), next(run)
    stored = np.asarray(state.replay.episodes.threshold)[: int(state.replay.inserted)]
    shares = [np.mean(np.isclose(stored[128:], threshold)) for threshold in first["threshold"]]
    assert len(stored) == 256
    assert shares[1] > 0.8
    assert sum(shares) == 1.0
    rates = second["threshold_rate_training"]
    assert (rates[0], rates[2]) == (0.0, 1.0)
    assert 0.3 < rates[1] < 0.7
    # Evaluation is at the environment's own threshold, which nothing reaches.
    assert first["success_rate"] == second["success_rate"] == 0.0
