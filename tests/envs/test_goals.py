import jax.numpy as jnp
import numpy as np

from cgm_jax.envs import numpy_goals
from cgm_jax.envs.goals import apply_mask, is_achieved, masked_distance


def test_masked_goals_keep_the_goal_where_the_mask_does() -> None:
    goal, achieved = jnp.array([1.0, 2.0, 3.0]), jnp.array([7.0, 8.0, 9.0])
    masked = apply_mask(goal, jnp.array([1.0, 0.0, 1.0]), achieved)
    np.testing.assert_array_equal(masked, [1, 8, 3])
    np.testing.assert_array_equal(apply_mask(goal, jnp.ones(3), achieved), goal)
    np.testing.assert_array_equal(apply_mask(goal, jnp.zeros(3), achieved), achieved)


def test_masked_distance_is_over_kept_dimensions() -> None:
    goal, achieved = jnp.array([3.0, 5.0, 4.0]), jnp.array([0.0, 100.0, 0.0])
    assert float(masked_distance(goal, jnp.array([1.0, 0.0, 1.0]), achieved)) == 5.0
    assert float(masked_distance(goal, jnp.zeros(3), achieved)) == 0.0


def test_a_goal_is_achieved_below_its_threshold() -> None:
    goal, achieved = jnp.array([[3.0, 0.0]] * 3), jnp.zeros((3, 2))
    masks = jnp.array([[1.0, 1.0], [1.0, 1.0], [0.0, 1.0]])
    reached = is_achieved(goal, masks, achieved, jnp.array([3.0, 3.1, 0.1]))
    np.testing.assert_array_equal(reached, [False, True, True])


def test_without_jax_goals_are_achieved_as_with_it() -> None:
    goal, achieved = np.array([3.0, 4.0, 0.0]), np.zeros((2, 3))
    thresholds = np.array([5.0, 5.1])
    reached = numpy_goals.is_achieved(achieved, goal, thresholds)
    np.testing.assert_array_equal(reached, [False, True])
    with_jax = is_achieved(jnp.array([goal] * 2), jnp.ones((2, 3)), jnp.array(achieved), thresholds)
    np.testing.assert_array_equal(reached, with_jax)
    np.testing.assert_array_equal(numpy_goals.sparse_reward(reached), [-1.0, 0.0])
    assert isinstance(numpy_goals.sparse_reward(np.bool_(True)), np.float64)
