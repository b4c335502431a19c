from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from brax.envs.base import State

from cgm_jax.config.settings import Settings
from cgm_jax.loop.environment import make_environment
from experiments.learning import sliders
from experiments.learning.sliders import Sliders

ENV = Sliders()


def final_distances(act: Callable[[State], jax.Array]) -> np.ndarray:
    """Distance per dimension at the end of 400 episodes, [400, 20]."""

    def episode(key: jax.Array) -> jax.Array:
        first = ENV.reset(key)
        last = jax.lax.fori_loop(0, ENV.episode_length, lambda _, s: ENV.step(s, act(s)), first)
        return jnp.abs(last.obs["achieved_goal"] - last.obs["desired_goal"])

    keys = jax.random.split(jax.random.key(0), 400)
    return np.asarray(jax.jit(jax.vmap(episode))(keys))


def towards_the_goal(state: State) -> jax.Array:
    return jnp.clip((state.obs["desired_goal"] - state.obs["achieved_goal"]) / 0.25, -1.0, 1.0)


def test_it_is_an_environment_that_training_accepts() -> None:
    env = make_environment(Settings(env=f"{sliders.__file__}:Sliders"))
    assert env.action_size == 20
    state = env.step(env.reset(jax.random.key(0)), jnp.ones(20))
    assert state.obs["desired_goal"].shape == (20,)
    # Twenty units are asked for and four served: a fifth of 0.25 each.
    np.testing.assert_allclose(state.obs["achieved_goal"], 0.05, rtol=1e-6)


def test_one_slider_is_not_held_up_by_the_others() -> None:
    state = ENV.step(ENV.reset(jax.random.key(0)), jnp.zeros(20).at[7].set(-1.0))
    np.testing.assert_allclose(state.obs["achieved_goal"], jnp.zeros(20).at[7].set(-0.25))


def test_all_goals_can_be_reached_and_doing_nothing_reaches_one_in_four() -> None:
    reached = final_distances(towards_the_goal)
    assert (np.linalg.norm(reached, axis=1) < ENV.distance_threshold).all()
    idle = final_distances(lambda state: jnp.zeros(20))
    assert np.mean(idle < ENV.distance_threshold) == pytest.approx(0.25, abs=0.02)
    assert (np.linalg.norm(idle, axis=1) > ENV.distance_threshold).all()
