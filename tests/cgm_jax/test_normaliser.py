from typing import Any

import jax.numpy as jnp
import numpy as np

from cgm_jax.normaliser import initial_normaliser, network_input, observe
from cgm_jax.replay import Episodes


def episodes(generator: np.random.Generator, count: int) -> Episodes:
    return Episodes(
        observation=jnp.asarray(generator.normal(3.0, 2.0, (count, 6, 2)), jnp.float32),
        achieved_goal=jnp.asarray(generator.normal(1.0, 0.5, (count, 6, 1)), jnp.float32),
        action=jnp.zeros((count, 5, 1)),
        desired_goal=jnp.asarray(generator.normal(-1.0, 0.5, (count, 1)), jnp.float32),
        mask=jnp.ones((count, 1)),
    )


def test_statistics_match_numpy_over_all_batches() -> None:
    generator = np.random.default_rng(0)
    normaliser: Any = initial_normaliser(2, 1)
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
    kept = good.replace(
        **{name: getattr(good, name)[jnp.array([0, 3])] for name in good.__dataclass_fields__}
    )
    expected: Any = observe(initial_normaliser(2, 1), kept, jnp.ones(2, bool))
    actual: Any = observe(initial_normaliser(2, 1), poison, jnp.array([True, False, False, True]))
    np.testing.assert_allclose(actual.observation.mean, expected.observation.mean, rtol=1e-6)
    np.testing.assert_allclose(actual.goal.std, expected.goal.std, rtol=1e-6)


def test_a_batch_of_only_dropped_episodes_changes_nothing() -> None:
    generator = np.random.default_rng(2)
    normaliser = observe(initial_normaliser(2, 1), episodes(generator, 3), jnp.ones(3, bool))
    before: Any
    for before in (initial_normaliser(2, 1), normaliser):
        after: Any = observe(before, episodes(generator, 3), jnp.zeros(3, bool))
        np.testing.assert_array_equal(after.observation.mean, before.observation.mean)
        np.testing.assert_array_equal(after.observation.std, before.observation.std)
        assert np.isfinite(np.asarray(after.goal.mean)).all()


def test_a_constant_entry_is_divided_by_the_floor() -> None:
    batch = episodes(np.random.default_rng(3), 4)
    batch = batch.replace(observation=jnp.full_like(batch.observation, 7.0))
    normaliser: Any = observe(initial_normaliser(2, 1), batch, jnp.ones(4, bool))
    np.testing.assert_allclose(normaliser.observation.std, 0.01)
    inputs = network_input(normaliser, jnp.array([7.02, 300.0]), jnp.zeros(1))
    np.testing.assert_allclose(inputs[:2], [2.0, 5.0], rtol=1e-3)
