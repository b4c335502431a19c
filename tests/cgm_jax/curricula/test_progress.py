import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest

from cgm_jax.config.fields import SettingError
from cgm_jax.curricula.parts.masks import goal_masks
from cgm_jax.curricula.progress import Progress
from cgm_jax.curricula.protocol import Goals, Outcomes
from tests.cgm_jax.curricula.small import SMALL, Chances, epochs, sizes
from tests.cgm_jax.probe import tiny


def outcomes(masks: np.ndarray, success: list[int]) -> Outcomes:
    count, goal_size = masks.shape
    goals = Goals(jnp.zeros((count, goal_size)), jnp.asarray(masks), jnp.ones(count))
    succeeded = jnp.array(success, bool)
    return Outcomes(
        goals=goals,
        success=succeeded,
        subgoal_success=jnp.ones((count, goal_size), bool),  # not what progress is about
        valid=jnp.ones(count, bool),
        observation=jnp.zeros((count, 1)),
    )


def test_probabilities_by_hand() -> None:
    curriculum = Progress(progress_window=4, progress_floor=0.1)
    state = curriculum.init(sizes(2))
    masks = np.asarray(goal_masks(2))
    np.testing.assert_array_equal(curriculum.probabilities(state), 0.25)
    # Mask 00 always succeeds, 01 is learned, 10 is being forgotten, 11 never succeeds.
    for success in ([1, 0, 1, 0], [1, 0, 1, 0], [1, 1, 1, 0], [1, 1, 0, 0]):
        state = curriculum.after_training(state, outcomes(masks, success))
    report = curriculum.report(state)
    np.testing.assert_allclose(report["mask_progress"], [0, 1, -0.5, 0])
    expected = np.array([0.1, 1.1, 0.6, 0.1]) / 1.9
    np.testing.assert_allclose(report["mask_probability"], expected, rtol=1e-6)


def test_goals_beyond_a_table_are_refused() -> None:
    with pytest.raises(SettingError, match=r"curriculum: progress needs a table .* not 11"):
        Progress().init(sizes(11))


def test_training_practises_what_is_being_learned_and_only_as_long() -> None:
    # The third sub-goal depends on the action, so masks 001 and 101 can be learned; the others
    # always or never succeed. Once they are mastered, nothing changes any more.
    hyper = tiny(
        curriculum="progress",
        progress_window=60,
        progress_floor=1e-3,
        discount=0.0,
        action_penalty=0.0,
        action_noise=0.2,
        actor_learning_rate=3e-3,
        critic_learning_rate=3e-3,
        random_action_probability=0.0,
    )
    settings = dataclasses.replace(SMALL, cycles_per_epoch=4, updates_per_cycle=40)
    run = epochs(Chances(by_action=True), hyper, settings)
    history = [next(run)[1] for _ in range(10)]
    assert history[0]["mask_share"][[1, 5]].sum() > 0.6
    mastered = [(metrics["mask_rate_training"][[1, 5]] == 1.0).all() for metrics in history]
    after = [i for i in range(1, 10) if mastered[i - 1] and mastered[i]]
    assert after
    for i in after:  # uniform: 256 episodes of eight masks
        np.testing.assert_allclose(history[i]["mask_share"], 1 / 8, atol=0.09)
