import jax
import jax.numpy as jnp
import numpy as np
import pytest

from cgm_jax.curricula.goid import GOID, GOIDState
from tests.cgm_jax.curricula.line import (
    SIZES,
    Line,
    drawn_goals,
    medium_share,
    outcomes,
    same_bits,
    view,
    walk,
)

GOALS = np.stack([np.repeat([0.0, 1.0, 2.0], 10), np.zeros(30)], axis=1)
"""Ten episodes each at three places, of which one, five and ten succeed."""
SUCCESS = np.concatenate([np.arange(10) < n for n in (1, 5, 10)])


def practised(curriculum: GOID) -> GOIDState:
    goals = drawn_goals(GOALS).replace(memo=jnp.asarray(0.0))
    return curriculum.after_training(curriculum.init(SIZES), outcomes(goals, SUCCESS))


def test_success_of_a_goal_is_that_of_the_episodes_nearest_to_it() -> None:
    curriculum = GOID()
    near = jnp.array([[-0.3, 0.0], [1.1, 0.1], [5.0, 0.0]])
    np.testing.assert_allclose(curriculum.rates(practised(curriculum), near), [0.1, 0.5, 1.0])


@pytest.mark.parametrize(("old_share", "expected"), [(0.0, {0, 1}), (1.0, {0, 1, 2})])
def test_new_goals_lie_between_too_hard_and_too_easy_and_old_ones_may_be_easy(
    old_share: float, expected: set[int]
) -> None:
    curriculum = GOID(old_goal_share=old_share)
    places = np.array([[[0.0, 0.0], [1.0, 0.0], [2.0, 0.0]]])
    goals = curriculum.sample(
        practised(curriculum),
        jax.random.key(0),
        drawn_goals(np.full((64, 2), 7.0)),
        view(places, 1, np.zeros((64, 2))),
    )
    assert set(np.asarray(goals.desired[:, 0], int)) == expected
    assert goals.mask.all()
    np.testing.assert_allclose(goals.memo, 2 / 3, atol=0.2)  # of 100 candidates at three places


def test_bounds_decide_what_is_too_hard() -> None:
    curriculum = GOID(least_success=0.2, old_goal_share=0.0)
    places = np.array([[[0.0, 0.0], [1.0, 0.0], [2.0, 0.0]]])
    goals = curriculum.sample(
        practised(curriculum),
        jax.random.key(0),
        drawn_goals(np.full((64, 2), 7.0)),
        view(places, 1, np.zeros((64, 2))),
    )
    np.testing.assert_array_equal(goals.desired, np.tile([1.0, 0.0], (64, 1)))


def test_while_replay_is_empty_goals_are_the_environments() -> None:
    curriculum, drawn = GOID(), drawn_goals([[1.0, 2.0], [3.0, 4.0]])
    goals = curriculum.sample(
        curriculum.init(SIZES), jax.random.key(0), drawn, view(np.zeros((5, 3, 2)), 0, [[0, 0]])
    )
    np.testing.assert_array_equal(goals.desired, drawn.desired)
    assert np.isnan(goals.memo)


def test_episodes_with_broken_physics_change_nothing() -> None:
    curriculum = GOID()
    state = practised(curriculum)
    goals = drawn_goals(GOALS).replace(memo=jnp.asarray(0.5))
    again = curriculum.after_training(state, outcomes(goals, ~SUCCESS, np.zeros(30, bool)))
    assert same_bits(again, state)


def test_the_report_says_how_the_practised_goals_went() -> None:
    curriculum = GOID()
    assert np.isnan(curriculum.report(curriculum.init(SIZES))["goid_success"])
    np.testing.assert_allclose(curriculum.report(practised(curriculum))["goid_success"], 16 / 30)


@pytest.mark.slow
def test_training_practises_goals_of_intermediate_success() -> None:
    """On the walk, that is known: at distances of 2.2 to 6.9 it is 90 to 10 %."""
    trained = walk("goid", Line(), 60, neighbours=30, old_goal_share=0.0, seed=1)[1]
    ours, full = (
        np.asarray(state.replay.episodes.desired_goal[-480:, 0])
        for state in (trained, walk("full", Line(), 60, seed=1)[1])
    )
    assert medium_share(np.asarray(trained.replay.episodes.achieved_goal).ravel()) < 0.3
    assert medium_share(full) < 0.45
    assert medium_share(ours) > 0.7


def test_where_every_practised_goal_is_too_hard_all_goals_are_new() -> None:
    curriculum = GOID(old_goal_share=1.0)
    goals = drawn_goals(GOALS).replace(memo=jnp.asarray(0.0))
    state = curriculum.after_training(curriculum.init(SIZES), outcomes(goals, np.zeros(30)))
    places = np.array([[[5.0, 0.0], [6.0, 0.0]]])
    sampled = curriculum.sample(
        state,
        jax.random.key(0),
        drawn_goals(np.full((64, 2), 7.0)),
        view(places, 1, np.zeros((64, 2))),
    )
    assert set(np.asarray(sampled.desired[:, 0])) == {5.0, 6.0}
