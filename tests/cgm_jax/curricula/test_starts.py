import jax
import jax.numpy as jnp
import numpy as np
import pytest
from brax.envs.base import State

from cgm_jax.config.fields import SettingError
from cgm_jax.config.sizes import Sizes
from cgm_jax.curricula.protocol import View
from cgm_jax.curricula.starts import Starts, StartsState
from tests.cgm_jax.curricula.line import (
    SIZES,
    Line,
    drawn_goals,
    medium_share,
    outcomes,
    same_bits,
    walk,
)


def states(position: np.ndarray) -> State:
    """States [E] at these positions [E, 2], each with the goal (9, position[0])."""
    here = jnp.asarray(position, jnp.float32)
    goal = jnp.stack([jnp.full(len(here), 9.0), here[:, 0]], axis=1)
    obs = {"observation": here, "achieved_goal": here, "desired_goal": goal}
    return State(None, obs, jnp.zeros(len(position)), jnp.zeros(len(position)))


STARTABLE: Sizes = SIZES._replace(
    starts=jax.tree.map(
        lambda leaf: jax.ShapeDtypeStruct(leaf.shape[1:], leaf.dtype), states(np.zeros((1, 2)))
    )
)


def value(observation: jax.Array, goal: jax.Array) -> jax.Array:
    """The critic knows that what counts is x."""
    del goal
    return observation[None, ..., 0]


def experienced(curriculum: Starts) -> StartsState:
    """Visited were x = 0, 1, 2; of ten episodes begun at each, none, five and ten succeeded."""
    begun = drawn_goals(np.stack([np.repeat([0.0, 1.0, 2.0], 10), np.zeros(30)], axis=1))
    success = np.concatenate([np.arange(10) < n for n in (0, 5, 10)])
    visited = states(np.asarray(begun.desired))
    result = outcomes(begun.replace(memo=jnp.asarray(0.0)), success, visited=visited)
    return curriculum.after_training(curriculum.init(STARTABLE), result)


def view(count: int) -> View:
    return View(states(np.full((count, 2), 7.0)), jnp.zeros((1, 1, 2)), jnp.asarray(0), value, None)  # pyright: ignore[reportArgumentType]


def test_success_of_a_start_is_that_of_starts_of_like_value() -> None:
    curriculum = Starts()
    rates = curriculum.rates(experienced(curriculum), view(1))
    np.testing.assert_allclose(rates[:30], np.repeat([0.0, 0.5, 1.0], 10))


def test_starts_are_visited_states_of_medium_success_with_their_goals_and_resets() -> None:
    curriculum = Starts(reset_share=0.25)
    drawn = drawn_goals(np.full((2000, 2), 5.0))
    goals = curriculum.sample(experienced(curriculum), jax.random.key(0), drawn, view(2000))
    x, desired = np.asarray(goals.start.obs["observation"][:, 0]), np.asarray(goals.desired)
    assert set(x) == {1.0, 7.0}
    np.testing.assert_allclose((x == 7.0).mean(), 0.25, atol=0.04)
    np.testing.assert_array_equal(desired[x == 7.0], drawn.desired[x == 7.0])
    assert (desired[x == 1.0] == [9.0, 1.0]).all()
    np.testing.assert_allclose(goals.memo, 1 / 3, rtol=1e-6)


def test_where_no_start_is_medium_any_visited_state_is_one() -> None:
    curriculum = Starts(reset_share=0.0, neighbours=30)  # all of the same estimate, 0.5
    sample = (jax.random.key(0), drawn_goals(np.zeros((300, 2))), view(300))
    every = curriculum.sample(experienced(curriculum), *sample).start.obs["observation"][:, 0]
    hard = Starts(reset_share=0.0, neighbours=30, least_success=0.51, most_success=0.52)
    none = hard.sample(experienced(hard), *sample).start.obs["observation"][:, 0]
    assert set(np.asarray(every)) == set(np.asarray(none)) == {0.0, 1.0, 2.0}


def test_before_anything_was_visited_episodes_begin_at_resets() -> None:
    curriculum, drawn = Starts(reset_share=0.0), drawn_goals(np.full((4, 2), 5.0))
    goals = curriculum.sample(curriculum.init(STARTABLE), jax.random.key(0), drawn, view(4))
    assert same_bits(goals.start, view(4).first)
    assert same_bits(goals.desired, drawn.desired)
    assert np.isnan(goals.memo)


def test_states_of_broken_episodes_are_no_starts() -> None:
    curriculum = Starts()
    state = experienced(curriculum)
    goals = drawn_goals(np.zeros((2, 2))).replace(memo=jnp.asarray(1.0))
    broken = outcomes(goals, [1, 1], np.zeros(2, bool), visited=states(np.full((2, 2), np.nan)))
    assert same_bits(curriculum.after_training(state, broken), state)


def test_an_environment_without_restart_is_refused() -> None:
    with pytest.raises(SettingError, match=r"^curriculum: starts needs an environment"):
        Starts().init(SIZES)


@pytest.mark.slow
def test_training_begins_at_medium_distance() -> None:
    """Resets are 8 from the goal, whence 3 % succeed; 10 to 90 % do from 6.9 to 2.2."""
    env = Line(lowest_goal=8.0, highest_goal=8.0)
    trained = walk("starts", env, 80, updates=20, neighbours=30)[1]
    ours, full = (
        np.asarray(state.replay.episodes.observation[-480:, 0, 0])
        for state in (trained, walk("full", env, 80)[1])
    )
    assert (full == 0.0).all()
    assert 0.4 < (ours == 0.0).mean() < 0.6
    begun = medium_share(8.0 - ours[ours != 0.0])
    visited = trained.curriculum.visited.rows.obs["observation"][:, 0]
    assert begun > 0.7
    assert medium_share(8.0 - np.asarray(visited)) < begun - 0.15


PLACES = np.stack([np.repeat([0.0, 1.0, 2.0], 10), np.zeros(30)], axis=1)


def test_starts_are_none_of_the_slots_that_hold_nothing_yet() -> None:
    # Empty slots look like x = 0, where five of ten succeed; states there have the goal (9, 0).
    curriculum = Starts(reset_share=0.0)
    success = np.concatenate([np.arange(10) < n for n in (5, 0, 0)])
    begun = drawn_goals(PLACES).replace(memo=jnp.asarray(0.0))
    state = curriculum.after_training(
        curriculum.init(STARTABLE), outcomes(begun, success, visited=states(PLACES))
    )
    goals = curriculum.sample(state, jax.random.key(0), drawn_goals(np.zeros((300, 2))), view(300))
    np.testing.assert_array_equal(goals.desired, np.tile([9.0, 0.0], (300, 1)))
    np.testing.assert_allclose(goals.memo, 1 / 3, rtol=1e-6)


def test_starts_are_judged_by_the_mean_of_critics_on_the_way_to_their_goals() -> None:
    # Begun and visited were x = 0, 1, 2 with the goal 9: all critics but the first know the way.
    curriculum = Starts()
    success = np.concatenate([np.arange(10) < n for n in (0, 5, 10)])
    begun = drawn_goals(np.full((30, 2), 9.0)).replace(memo=jnp.asarray(0.0))
    happened = outcomes(begun, success, visited=states(PLACES)).replace(
        observation=jnp.asarray(PLACES, jnp.float32)
    )
    state = curriculum.after_training(curriculum.init(STARTABLE), happened)

    def value(observation: jax.Array, goal: jax.Array) -> jax.Array:
        way = goal[..., 0] - observation[..., 0]
        return jnp.stack([0.0 * way, -way])

    rates = curriculum.rates(state, view(1)._replace(value=value))
    np.testing.assert_allclose(rates[:30], np.repeat([0.0, 0.5, 1.0], 10))
