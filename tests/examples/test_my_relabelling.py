"""A user's own way to relabel; test_my_curriculum.py trains with it by the command line."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from cgm_jax.replay.future import Future
from cgm_jax.replay.ring import Episodes, Replay, init_replay, insert
from tests.examples.my_relabelling import Final

EPISODES, LENGTH, COUNT = 3, 4, 500


def ring(length: jax.Array | None) -> Replay:
    """Episodes whose achieved goal is (episode, step), and so tells where it was taken from."""
    numbers, steps = np.arange(EPISODES), np.arange(LENGTH + 1)
    places = jnp.asarray(np.stack(np.meshgrid(numbers, steps, indexing="ij"), -1), jnp.float32)
    episodes = Episodes(
        observation=places,
        achieved_goal=places,
        action=places[:, :-1],
        desired_goal=jnp.full((EPISODES, 2), -1.0),
        mask=jnp.ones((EPISODES, 2)),
        threshold=jnp.full(EPISODES, 0.5),
        length=length,
    )
    replay = init_replay(EPISODES, LENGTH, 2, 2, 2, may_end=length is not None)
    return insert(replay, episodes, jnp.ones(EPISODES, bool))


@pytest.mark.parametrize(
    ("length", "ends"), [(None, [4, 4, 4]), (jnp.array([2, 5, 3], jnp.int32), [2, 4, 3])]
)
def test_hindsight_goals_are_where_episodes_came_to(
    length: jax.Array | None, ends: list[int]
) -> None:
    replay, key = ring(length), jax.random.key(0)
    final = Final(her_k=1.0).sample(key, replay, COUNT, 0.5)
    episode, step = np.asarray(final.observation).astype(int).T
    relabelled = np.asarray(final.goal[:, 0]) >= 0
    assert 0.4 < relabelled.mean() < 0.6
    expected = np.stack([episode, np.array(ends)[episode]], -1)
    np.testing.assert_array_equal(final.goal[relabelled], expected[relabelled])
    np.testing.assert_array_equal(final.goal[~relabelled], -1.0)
    arrives = relabelled & (step + 1 == np.array(ends)[episode])
    np.testing.assert_array_equal(final.reward, np.where(arrives, 0.0, -1.0))
    future = Future(her_k=1.0).sample(key, replay, COUNT, 0.5)
    np.testing.assert_array_equal(future.observation, final.observation)
    assert np.any(np.asarray(future.goal) != np.asarray(final.goal))
