"""What code written against Gymnasium-Robotics reads of MuJoCo: `model`, `data`, `initial_qpos`.

Its tests of environments do so too; those that others here do not cover are at the end.
"""

# Gymnasium leaves its environments untyped; mujoco's compiled modules come without stubs.
# pyright: reportAttributeAccessIssue=false, reportOptionalMemberAccess=false

from typing import Any

import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from cgm_jax.envs.physics.mjx import MjxPhysics, Motion
from cgm_jax.envs.physics.protocol import PhysicsState
from tests.envs.gymnasium.helpers import NAMES, make
from tests.envs.surface import can_render

OBJECT_XY = slice(-7, -5)
"""Of an object's free joint, the last one: x and y, which each reset draws anew."""


def state_of(inner: Any) -> np.ndarray:
    kind = int(mujoco.mjtState.mjSTATE_INTEGRATION.value)
    state = np.zeros(mujoco.mj_stateSize(inner.model, kind))
    mujoco.mj_getState(inner.model, inner.data, state, kind)
    return state


@pytest.mark.parametrize("name", NAMES)
def test_the_data_are_those_of_the_present_state(name: str) -> None:
    inner = make(name).unwrapped
    inner.action_space.seed(0)
    observation, _ = inner.reset(seed=0)
    held = inner.data
    for step in range(4):
        positions = inner.fetch.physics.positions(inner.state.pipeline_state)
        np.testing.assert_array_equal(held.qpos, positions)
        assert held is inner.data
        assert held.time == pytest.approx(0.04 * step)
        grip = held.site("grip").xpos
        np.testing.assert_allclose(grip, observation["observation"][:3], atol=1e-6)
        if name != "FetchReach":
            place = held.body("object").xpos
            np.testing.assert_allclose(place, observation["achieved_goal"], atol=1e-6)
        before = positions
        observation, *_ = inner.step(inner.action_space.sample())
        assert np.abs(held.qpos - before).max() > 1e-4


@pytest.mark.parametrize("name", NAMES)
def test_an_episode_starts_where_the_initial_positions_say_but_for_the_object(name: str) -> None:
    inner = make(name).unwrapped
    np.testing.assert_allclose(inner.data.qpos, inner.initial_qpos, atol=1e-6)
    for seed in (24, 10):
        inner.reset(seed=seed)
        positions, initial = inner.data.qpos.copy(), inner.initial_qpos
        if name != "FetchReach":
            assert np.abs(positions[OBJECT_XY] - initial[OBJECT_XY]).max() > 1e-3
            positions[OBJECT_XY] = initial[OBJECT_XY]
        np.testing.assert_array_equal(positions, initial)
        np.testing.assert_array_equal(inner.data.qvel, inner.initial_qvel)
        inner.step(np.ones(4))
        assert np.abs(inner.data.qvel).max() > 0.01


@pytest.mark.parametrize("name", NAMES)
def test_a_reset_leaves_nothing_of_the_steps_before(name: str) -> None:
    inner = make(name).unwrapped
    inner.reset(seed=1234)
    first = state_of(inner)
    inner.step(np.ones(4))
    assert (state_of(inner) != first).any()
    inner.reset(seed=1234)
    np.testing.assert_array_equal(state_of(inner), first)


def test_data_follow_a_state_that_is_set_by_hand() -> None:
    inner = make("FetchPush").unwrapped
    inner.reset(seed=0)
    assert inner.data.qpos[OBJECT_XY] == pytest.approx(inner.state.obs["achieved_goal"][:2])
    inner.state = inner.fetch.reset_to(jnp.array([1.25, 0.6]), jnp.array([1.3, 0.7, 0.42]))
    assert inner.data.qpos[OBJECT_XY] == pytest.approx([1.25, 0.6])


def test_they_are_copies_to_be_read() -> None:
    inner, twin = make("FetchPush").unwrapped, make("FetchPush").unwrapped
    inner.reset(seed=0)
    twin.reset(seed=0)
    inner.data.qpos[:] = 0.0
    inner.model.opt.gravity[:] = 0.0
    inner.initial_qpos[:] = 0.0
    assert twin.model.opt.gravity[2] == pytest.approx(-9.81)
    assert np.abs(inner.initial_qpos).max() > 0.1
    for _ in range(2):
        one, other = inner.step(np.ones(4))[0], twin.step(np.ones(4))[0]
        np.testing.assert_array_equal(one["observation"], other["observation"])
        np.testing.assert_array_equal(inner.data.qpos, twin.data.qpos)
    for name in ("model", "data", "initial_qpos", "initial_qvel"):
        with pytest.raises(AttributeError):
            setattr(inner, name, getattr(twin, name))


def test_mjx_hands_over_positions_and_velocities() -> None:
    inner = make("FetchPush").unwrapped
    model, data = inner.model, inner.data
    generator = np.random.default_rng(0)
    motion = Motion(
        *(jnp.asarray(generator.normal(size=n)) for n in (model.nq, model.nv, model.nv))
    )
    state = PhysicsState(engine_state=motion, sensors=jnp.zeros(3), warnings=jnp.zeros((), int))
    MjxPhysics.copy_to_mujoco(object.__new__(MjxPhysics), state, data)
    np.testing.assert_array_equal(data.qpos, motion.positions)
    np.testing.assert_array_equal(data.qvel, motion.velocities)


@pytest.mark.parametrize("name", NAMES)
def test_two_environments_of_one_seed_agree_for_an_episode(name: str) -> None:
    one, other = make(name), make(name)
    one.action_space.seed(0)
    for env in (one, other):
        first, _ = env.reset(seed=0)
    assert first in one.observation_space
    rest: list[Any] = []
    for _ in range(50):
        action = one.action_space.sample()
        (a, *rest), (b, *others) = one.step(action), other.step(action)
        for entry in a:
            np.testing.assert_array_equal(a[entry], b[entry])
        assert rest == others
        assert a in one.observation_space
    assert rest[2]  # truncated, after the 50th step


@pytest.mark.skipif(not can_render(), reason="this machine has no off-screen rendering")
@pytest.mark.parametrize("name", NAMES)
def test_every_render_mode_that_is_offered_works(name: str) -> None:
    modes = make(name).metadata["render_modes"]
    assert modes == ["rgb_array"]
    for mode in modes:
        env = make(name).spec.make(render_mode=mode, width=64, height=48)
        env.reset(seed=0)
        env.step(env.action_space.sample())
        assert len(np.unique(env.render())) > 10
        env.close()
