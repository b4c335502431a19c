from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from cgm_jax.loop import normaliser as module
from cgm_jax.loop.normaliser import Normaliser, network_input
from cgm_jax.replay.ring import Episodes

THRESHOLD = 0.05


def init_normaliser(observation_size: int, goal_size: int) -> Normaliser:
    return module.init_normaliser(
        observation_size, goal_size, limit=5.0, distance_threshold=THRESHOLD
    )


compiled_observe = jax.jit(module.observe, static_argnames=("floor", "distance_threshold"))


def observe(
    normaliser: Normaliser,
    episodes: Episodes,
    valid: Any,
    drawn_goal: Any = None,
    floor: float = 0.2,
) -> Normaliser:
    drawn_goal = episodes.desired_goal if drawn_goal is None else drawn_goal
    return compiled_observe(
        normaliser, episodes, valid, drawn_goal, floor=floor, distance_threshold=THRESHOLD
    )


def episodes(generator: np.random.Generator, count: int) -> Episodes:
    return Episodes(
        observation=jnp.asarray(generator.normal(3.0, 2.0, (count, 6, 2)), jnp.float32),
        achieved_goal=jnp.asarray(generator.normal(1.0, 0.5, (count, 6, 1)), jnp.float32),
        action=jnp.zeros((count, 5, 1)),
        desired_goal=jnp.asarray(generator.normal(-1.0, 0.5, (count, 1)), jnp.float32),
        mask=jnp.ones((count, 1)),
        threshold=jnp.full(count, THRESHOLD),
    )


def test_statistics_match_numpy_over_all_batches() -> None:
    generator = np.random.default_rng(0)
    normaliser: Any = init_normaliser(2, 1)
    batches = []
    for count in (3, 8, 20):
        batches.append(episodes(generator, count))
        normaliser = observe(normaliser, batches[-1], jnp.ones(count, bool))
    rows = np.concatenate([np.asarray(b.observation).reshape(-1, 2) for b in batches])
    np.testing.assert_allclose(normaliser.observation.mean, rows.mean(0), rtol=1e-5)
    np.testing.assert_allclose(normaliser.observation.std, rows.std(0), rtol=1e-5)
    goals = [
        np.concatenate(
            [
                np.asarray(b.achieved_goal)[:, 1:].reshape(-1, 1),
                np.repeat(np.asarray(b.desired_goal), 5, 0),
            ]
        )
        for b in batches
    ]
    np.testing.assert_allclose(normaliser.goal.mean, np.concatenate(goals).mean(0), rtol=1e-5)
    inputs = network_input(normaliser, jnp.asarray(rows[0]), jnp.zeros(1))
    np.testing.assert_allclose(
        inputs[:2], np.clip((rows[0] - rows.mean(0)) / rows.std(0), -5, 5), rtol=1e-4
    )


def test_dropped_and_broken_episodes_leave_no_trace() -> None:
    generator = np.random.default_rng(1)
    good = episodes(generator, 4)
    poison = good.replace(observation=good.observation.at[1].set(jnp.nan))
    poison = poison.replace(achieved_goal=poison.achieved_goal.at[2, 3].set(jnp.inf))
    kept = jax.tree.map(lambda leaf: leaf[jnp.array([0, 3])], good)
    expected: Any = observe(init_normaliser(2, 1), kept, jnp.ones(2, bool))
    actual: Any = observe(init_normaliser(2, 1), poison, jnp.array([True, False, False, True]))
    np.testing.assert_allclose(actual.observation.mean, expected.observation.mean, rtol=1e-6)
    np.testing.assert_allclose(actual.goal.std, expected.goal.std, rtol=1e-6)


def test_what_is_repeated_after_an_early_end_does_not_count() -> None:
    batch = episodes(np.random.default_rng(6), 4)
    length = np.array([6, 2, 5, 3])  # of five steps: to the end, two, exactly five, three
    ended = batch.replace(length=jnp.asarray(length, jnp.int32))
    actual: Any = observe(init_normaliser(2, 1), ended, jnp.arange(4) != 3)
    seen, achieved, desired = (
        np.asarray(x) for x in (batch.observation, batch.achieved_goal, batch.desired_goal)
    )
    steps = [5, 2, 5]
    rows = np.concatenate([seen[i, : n + 1] for i, n in enumerate(steps)])
    goals = np.concatenate(
        [np.concatenate([achieved[i, 1 : n + 1], desired[[i] * n]]) for i, n in enumerate(steps)]
    )
    assert (len(rows), len(goals)) == (15, 24)
    for statistics, expected in ((actual.observation, rows), (actual.goal, goals)):
        np.testing.assert_allclose(statistics.mean, expected.mean(0), rtol=1e-5)
        np.testing.assert_allclose(statistics.std, expected.std(0), rtol=1e-5)
        assert int(statistics.count.lo) == len(expected)


def test_a_batch_of_only_dropped_episodes_changes_nothing() -> None:
    generator = np.random.default_rng(2)
    normaliser = observe(init_normaliser(2, 1), episodes(generator, 3), jnp.ones(3, bool))
    before: Any
    for before in (init_normaliser(2, 1), normaliser):
        after: Any = observe(before, episodes(generator, 3), jnp.zeros(3, bool))
        np.testing.assert_array_equal(after.observation.mean, before.observation.mean)
        np.testing.assert_array_equal(after.observation.std, before.observation.std)
        assert np.isfinite(np.asarray(after.goal.mean)).all()


def test_a_constant_entry_is_divided_by_the_floor() -> None:
    batch = episodes(np.random.default_rng(3), 4)
    batch = batch.replace(observation=batch.observation.at[..., 0].set(7.0))
    normaliser: Any = observe(init_normaliser(2, 1), batch, jnp.ones(4, bool))
    assert normaliser.observation.std[0] == np.float32(0.01)  # as before, to the last bit
    inputs = network_input(normaliser, jnp.array([7.02, 300.0]), jnp.zeros(1))
    np.testing.assert_allclose(inputs[:2], [2.0, 5.0], rtol=1e-3)


@pytest.mark.parametrize("floor", [0.0, 1e-50])
def test_without_a_floor_an_entry_that_is_always_zero_stays_zero(floor: float) -> None:
    batch = episodes(np.random.default_rng(7), 4)
    batch = batch.replace(
        observation=batch.observation.at[..., 0].set(0.0),
        achieved_goal=jnp.zeros((4, 6, 1)),
        desired_goal=jnp.zeros((4, 1)),
    )
    normaliser: Any = init_normaliser(2, 1)
    for _ in range(2):
        normaliser = observe(normaliser, batch, jnp.ones(4, bool), floor=floor)
    seen = np.asarray(batch.observation)[..., 1]
    assert normaliser.observation.std[0] == normaliser.goal.std[0] == 1.0  # 20 thresholds
    np.testing.assert_allclose(normaliser.observation.std[1], seen.std(), rtol=1e-5)
    inputs = network_input(
        normaliser, jnp.array([[0.0, seen.mean()], [2.0, 0.0]]), jnp.zeros((2, 1))
    )
    np.testing.assert_allclose(inputs[:, 0], [0.0, 2.0])
    np.testing.assert_allclose(inputs[0], 0.0, atol=1e-5)


def test_the_floor_gives_way_where_observations_have_a_smaller_unit_than_goals() -> None:
    batch = episodes(np.random.default_rng(4), 40)
    small = 1e-5 * batch.observation.at[..., 1].divide(8.0)
    normaliser: Any = observe(
        init_normaliser(2, 1), batch.replace(observation=small), jnp.ones(40, bool)
    )
    first, second = np.asarray(small[..., 0]).std(), np.asarray(small[..., 1]).std()
    assert second < first < 0.01
    np.testing.assert_allclose(normaliser.observation.std, [first, first], rtol=1e-4)


@pytest.mark.parametrize("origin", [500.0, -3e5])
def test_statistics_far_from_the_origin_are_those_of_float64(origin: float) -> None:
    generator = np.random.default_rng(5)
    normaliser: Any = init_normaliser(2, 1)
    batches = []
    for _ in range(3):
        batch = episodes(generator, 8)
        batch = batch.replace(observation=batch.observation + origin)
        # Before the first row that counts nothing may decide where the sums start.
        batch = batch.replace(observation=batch.observation.at[0].set(jnp.nan))
        batches.append(batch)
        normaliser = observe(normaliser, batch, jnp.arange(8) > 0)
    rows = np.concatenate([np.asarray(b.observation[1:], float).reshape(-1, 2) for b in batches])
    np.testing.assert_allclose(normaliser.observation.std, rows.std(0), rtol=1e-3)
    np.testing.assert_allclose(
        normaliser.observation.mean - origin, rows.mean(0) - origin, atol=0.05
    )


def test_goals_that_the_environment_draws_count_where_a_curriculum_chooses_others() -> None:
    batch = episodes(np.random.default_rng(6), 30)
    batch = batch.replace(
        achieved_goal=0.01 * batch.achieved_goal, desired_goal=jnp.full((30, 1), 0.01)
    )
    far = jnp.linspace(-1.0, 1.0, 30)[:, None]
    normaliser: Any = observe(init_normaliser(2, 1), batch, jnp.ones(30, bool), far)
    # Of five rows of desired goals in an episode three are chosen ones, in the next one two.
    chosen = np.where(np.add.outer(np.arange(30), np.arange(5)) % 2 == 0, 0.01, far)
    rows = np.concatenate([np.asarray(batch.achieved_goal)[:, 1:].ravel(), chosen.ravel()])
    np.testing.assert_allclose(normaliser.goal.std, rows.std(), rtol=1e-4)
    near, beyond = network_input(normaliser, jnp.zeros((2, 2)), jnp.array([[0.5], [0.9]]))
    assert near[2] < beyond[2] < 5.0  # seen as two goals, neither clipped
