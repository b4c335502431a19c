import jax
import jax.numpy as jnp
import numpy as np

from cgm_jax.envs import make


def test_an_episode_begins_in_a_visited_state_as_if_it_went_on() -> None:
    env = make("push", engine="native")
    step = jax.jit(env.step)
    state = jax.jit(env.reset)(jax.random.key(0))
    for action in jax.random.uniform(jax.random.key(1), (5, 4), minval=-1.0, maxval=1.0):
        state = step(state, action)
    doubtful = state.replace(
        pipeline_state=state.pipeline_state.replace(warnings=jnp.asarray(3, jnp.int32))
    )
    begun = jax.jit(env.restart)(doubtful)
    assert begun.metrics["physics_warnings"] == 0
    pairs = zip(jax.tree.leaves(begun), jax.tree.leaves(state), strict=True)
    for ours, visited in pairs:
        assert ours.dtype == visited.dtype
        np.testing.assert_array_equal(ours, visited)
    onward = jnp.array([1.0, -1.0, 0.5, 0.0])
    for ours, visited in zip(
        jax.tree.leaves(step(begun, onward)), jax.tree.leaves(step(state, onward)), strict=True
    ):
        np.testing.assert_array_equal(ours, visited)
