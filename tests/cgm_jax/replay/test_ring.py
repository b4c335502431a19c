import jax
import jax.numpy as jnp
import numpy as np
import pytest

from cgm_jax.replay.ring import Episodes, Replay, init_replay, insert, size

LENGTH, OBSERVATION, GOAL, ACTION = 4, 2, 3, 1


def encoded(first: int, count: int) -> Episodes:
    """Episodes whose every number tells which episode and step it belongs to."""
    number = np.arange(first, first + count, dtype=np.float32)

    def rows(steps: int, width: int) -> jax.Array:
        code = 1000 * number[:, None] + np.arange(steps)
        return jnp.asarray(np.repeat(code[..., None], width, -1))

    return Episodes(
        observation=rows(LENGTH + 1, OBSERVATION),
        achieved_goal=rows(LENGTH + 1, GOAL),
        action=rows(LENGTH, ACTION),
        desired_goal=jnp.asarray(np.repeat(number[:, None], GOAL, -1)),
        mask=jnp.ones((count, GOAL)),
        threshold=jnp.asarray(number),
    )


def held(replay: Replay) -> list[int]:
    return [int(number) for number in np.asarray(replay.episodes.desired_goal)[:, 0]]


def test_the_ring_holds_the_newest_episodes_when_the_batch_does_not_divide_it() -> None:
    replay = init_replay(7, LENGTH, OBSERVATION, GOAL, ACTION)
    for first in range(1, 13, 3):  # episodes 1 to 12, three at a time, into 7 slots
        replay = insert(replay, encoded(first, 3), jnp.ones(3, bool))
    assert held(replay) == [8, 9, 10, 11, 12, 6, 7]
    assert int(size(replay)) == 7
    expected = encoded(8, 5)
    for ring, batch in zip(
        jax.tree.leaves(replay.episodes), jax.tree.leaves(expected), strict=True
    ):
        np.testing.assert_array_equal(ring[:5], batch)


def test_dropped_episodes_leave_no_gap() -> None:
    replay = init_replay(4, LENGTH, OBSERVATION, GOAL, ACTION)
    replay = insert(replay, encoded(1, 4), jnp.array([True, False, False, True]))
    assert held(replay) == [1, 4, 0, 0]
    assert int(size(replay)) == 2
    replay = insert(replay, encoded(5, 3), jnp.array([True, True, True]))
    assert held(replay) == [7, 4, 5, 6]


def test_runs_with_different_drops_fill_their_own_rings() -> None:
    replay = jax.vmap(lambda _: init_replay(3, LENGTH, OBSERVATION, GOAL, ACTION))(jnp.arange(2))
    batch = jax.tree.map(lambda leaf: jnp.stack([leaf, leaf]), encoded(1, 2))
    replay = jax.vmap(insert)(replay, batch, jnp.array([[True, True], [False, True]]))
    np.testing.assert_array_equal(replay.episodes.desired_goal[:, :, 0], [[1, 2, 0], [2, 0, 0]])
    np.testing.assert_array_equal(jax.vmap(size)(replay), [2, 1])


def test_a_batch_larger_than_the_ring_is_refused() -> None:
    with pytest.raises(ValueError, match="3 episodes do not fit"):
        insert(init_replay(2, LENGTH, OBSERVATION, GOAL, ACTION), encoded(0, 3), jnp.ones(3, bool))
