# Brax types the parts of its State as unknown.
# pyright: reportAttributeAccessIssue=false, reportOptionalMemberAccess=false
# pyright: reportGeneralTypeIssues=false

import math
from pathlib import Path

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
import scipy.stats
from brax.envs.wrappers.training import EpisodeWrapper

from cgm_jax import envs
from cgm_jax.envs.fetch import FetchEnvironment
from cgm_jax.envs.mocap_controller import ControlTarget
from cgm_jax.envs.physics.native import NativePhysics
from experiments.physics.scripted import CONTROLLERS, Player, success
from tests.envs.measures import warnings

STARTS = Path(__file__).parents[1] / "data" / "gymnasium_starts.npz"
GRIP_HOME = {
    "push": (1.3455, 0.7490, 0.4136),
    "pick_and_place": (1.3419, 0.7491, 0.5347),
    "reach": (1.3419, 0.7491, 0.5347),
}


@pytest.fixture(scope="module", params=["reach", "push", "pick_and_place"])
def env(request: pytest.FixtureRequest) -> FetchEnvironment:
    return envs.make(request.param, engine="native")


def test_reset_puts_the_grip_where_gymnasium_robotics_does(env: FetchEnvironment) -> None:
    name = next(name for name, task in envs.TASKS.items() if task is env.task)
    state = jax.jit(env.reset_to)(jnp.array([1.25, 0.6]), jnp.array([1.3, 0.7, 0.5]))
    np.testing.assert_allclose(state.obs["observation"][:3], GRIP_HOME[name], atol=2e-4)
    np.testing.assert_allclose(state.obs["desired_goal"], [1.3, 0.7, 0.5])
    if env.task.has_object:
        np.testing.assert_allclose(state.obs["achieved_goal"], [1.25, 0.6, 0.4247], atol=1e-4)
    else:
        np.testing.assert_array_equal(state.obs["achieved_goal"], state.obs["observation"][:3])


def test_starts_and_goals_follow_the_rules(env: FetchEnvironment) -> None:
    keys = jax.random.split(jax.random.key(0), 4000)
    grip = env.scene.grip_home
    objects = np.asarray(jax.vmap(env.sample_object)(keys)) - grip[:2]
    distance = np.linalg.norm(objects, axis=1)
    assert np.abs(objects).max() <= 0.15 + 1e-6
    assert distance.min() >= 0.1 - 1e-6
    # Uniform on the square less the disc: compare the share beyond 0.15 m with its area.
    area, disc = 0.3**2, np.pi * 0.1**2
    beyond = (area - np.pi * 0.15**2) / (area - disc)
    assert np.mean(distance > 0.15) == pytest.approx(beyond, abs=0.03)
    np.testing.assert_allclose(objects.mean(axis=0), 0.0, atol=0.006)

    goals = np.asarray(jax.vmap(env.sample_goal)(keys)) - grip
    assert len(np.unique(goals, axis=0)) == len(keys)
    assert np.abs(goals[:, :2]).max() <= 0.15 + 1e-6
    uniform = scipy.stats.uniform(-0.15, 0.3).cdf
    assert all(scipy.stats.kstest(goals[:, i], uniform).pvalue > 0.01 for i in (0, 1))
    height = goals[:, 2] + grip[2]
    if env.scene.object_home is None:
        assert np.abs(goals[:, 2]).max() <= 0.15 + 1e-6
    elif env.task.air_probability == 0:
        np.testing.assert_allclose(height, env.scene.object_home[2], atol=1e-6)
    else:
        height = height - env.scene.object_home[2]
        assert height.min() >= -1e-6
        assert height.max() <= 0.45 + 1e-6
        assert scipy.stats.kstest(height, scipy.stats.uniform(0, 0.45).cdf).pvalue > 0.01


@pytest.mark.parametrize("env", ["push", "pick_and_place"], indirect=True)
def test_the_object_settles_where_it_was_put(env: FetchEnvironment) -> None:
    step, state = jax.jit(env.step), env.reset_to(jnp.array([1.25, 0.6]), jnp.zeros(3))
    for _ in range(15):
        state = step(state, jnp.zeros(4))
    settled = np.asarray(state.obs["achieved_goal"])
    assert settled[2] == pytest.approx(0.4247, abs=5e-4)
    np.testing.assert_allclose(settled[:2], [1.25, 0.6], atol=5e-4)


@pytest.mark.parametrize("task", ["push", "pick_and_place"])
def test_starts_and_goals_are_distributed_as_the_recorded_ones(task: str) -> None:
    """Kolmogorov-Smirnov tests against Gymnasium-Robotics, whose goals are half in the air."""
    fields = {"air_probability": 0.5} if task == "pick_and_place" else {}
    env = envs.make(task, engine="native", **fields)
    with np.load(STARTS) as file:
        grip, block, goal = (file[f"{task}/{name}"] for name in ("grip", "object", "goal"))
    np.testing.assert_allclose(grip, np.tile(env.scene.grip_home, (60, 1)), atol=2e-4)
    np.testing.assert_allclose(block[:, 2], 0.4247, atol=1e-4)

    object_keys, goal_keys = jax.random.split(jax.random.key(5), (2, 4000))
    objects = np.asarray(jax.vmap(env.sample_object)(object_keys))
    goals = np.asarray(jax.vmap(env.sample_goal)(goal_keys))
    pairs = [(objects[:, i], block[:, i]) for i in (0, 1)]
    pairs += [(goals[:, i], goal[:, i]) for i in (0, 1)]
    offsets = (points[:, :2] - env.scene.grip_home[:2] for points in (objects, block))
    pairs.append(tuple(np.linalg.norm(offset, axis=1) for offset in offsets))
    if task == "push":
        np.testing.assert_allclose(goals[:, 2], goal[:, 2].mean(), atol=1e-4)
    else:
        table = 0.4247 + 1e-4
        assert np.mean(goal[:, 2] > table) == pytest.approx(np.mean(goals[:, 2] > table), abs=0.2)
        pairs.append((goals[goals[:, 2] > table, 2], goal[goal[:, 2] > table, 2]))
    for ours, recorded in pairs:
        assert scipy.stats.ks_2samp(ours, recorded).pvalue > 0.01


def test_air_probability_is_the_share_of_goals_above_the_table() -> None:
    env = envs.make("pick_and_place", engine="native", air_probability=0.25)
    goals = jax.vmap(env.sample_goal)(jax.random.split(jax.random.key(1), 4000))
    assert np.mean(np.asarray(goals)[:, 2] > 0.4248) == pytest.approx(0.25, abs=0.03)


def test_a_full_action_moves_the_grip_by_about_three_centimetres(env: FetchEnvironment) -> None:
    step = jax.jit(env.step)
    state = env.reset_to(jnp.array([1.25, 0.6]), jnp.zeros(3))
    state = step(state, jnp.array([0.0, 0.0, 1.0, 0.0]))  # clear of the table
    for axis, sign in ((0, 1), (1, -1), (2, 1)):
        action = np.zeros(4, np.float32)
        action[axis] = sign
        path = [state]
        for _ in range(3):
            path.append(step(path[-1], jnp.asarray(action)))
        state = path[-1]
        moved = np.asarray(state.obs["observation"][:3] - path[-2].obs["observation"][:3])
        assert moved[axis] * sign == pytest.approx(0.032, abs=0.003)
        assert np.abs(np.delete(moved, axis)).max() < 0.004


def test_success_and_reward_are_those_of_the_threshold() -> None:
    env = envs.make("push", engine="native")
    resting = env.reset_to(jnp.array([1.25, 0.6]), jnp.array([1.25, 0.649, 0.4247]))
    assert float(resting.reward) == 0.0
    assert float(resting.metrics["success"]) == 1.0
    away = env.reset_to(jnp.array([1.25, 0.6]), jnp.array([1.25, 0.651, 0.4247]))
    assert float(away.reward) == -1.0


@pytest.mark.parametrize("task", ["push", "pick_and_place"])
def test_a_controller_written_by_hand_solves_the_task(task: str) -> None:
    states = Player(envs.make(task, engine="native")).play(CONTROLLERS[task], 200)
    assert warnings(states) == 0
    assert success(states[:1]).mean() < 0.2  # of starts that need nothing done
    assert success(states).mean() >= 0.97


def rolled(env: FetchEnvironment, actions: jax.Array) -> jax.Array:
    """Observations [T + 1, E, o] under actions [T, E, 4], from one set of resets."""
    state = jax.vmap(env.reset)(jax.random.split(jax.random.key(7), actions.shape[1]))

    def step(state, action):  # noqa: ANN001, ANN202
        state = jax.vmap(env.step)(state, action)
        return state, state.obs["observation"]

    first = state.obs["observation"]
    return jnp.concatenate([first[None], jax.lax.scan(step, state, actions)[1]])


def test_native_has_the_same_bits_at_any_number_of_threads_and_in_any_company() -> None:
    env = envs.make("pick_and_place", engine="native")
    actions = jax.random.uniform(jax.random.key(2), (20, 8, 4), minval=-1.0, maxval=1.0)
    reference = None
    for threads in (1, 2, 5):
        one = FetchEnvironment(env.task, env.scene, NativePhysics(env.scene, threads), 1.0)
        observations = np.asarray(jax.jit(lambda a, one=one: rolled(one, a))(actions))
        reference = observations if reference is None else reference
        np.testing.assert_array_equal(observations, reference)
    doubled = jax.jit(jax.vmap(lambda a: rolled(env, a)))(jnp.stack([actions, actions]))
    np.testing.assert_array_equal(doubled[0], reference)
    np.testing.assert_array_equal(doubled[1], reference)


def test_native_state_survives_the_journey_through_jax_exactly() -> None:
    """Control steps through JAX give the float64 bits of the same steps in plain MuJoCo."""
    env = envs.make("push", engine="native")
    state = env.reset_to(jnp.array([1.25, 0.6]), jnp.zeros(3))
    model, data = env.scene.model, mujoco.MjData(env.scene.model)
    data.qpos[:] = env.scene.home.astype(np.float32)
    data.joint("object").qpos[:2] = np.array([1.25, 0.6], np.float32)
    target = ControlTarget(jnp.array([1.4, 0.7, 0.5]), jnp.array([1.0, 0, 1, 0]), jnp.zeros(2))
    data.mocap_pos[0], data.mocap_quat[0] = target.mocap_position, target.mocap_orientation
    physics_state, advance = state.pipeline_state, jax.jit(env.physics.advance)
    for _ in range(5):
        physics_state = advance(physics_state, target)
        data.qpos[list(env.scene.blocked_addresses)] = 0.0
        mujoco.mj_step(model, data, nstep=env.scene.substeps)
    row = np.asarray(physics_state.engine_state).view(np.float64)
    np.testing.assert_array_equal(row[1 : 1 + model.nq], data.qpos)
    np.testing.assert_array_equal(row[1 + model.nq : 1 + model.nq + model.nv], data.qvel)
    assert (data.qpos != data.qpos.astype(np.float32)).any()  # float32 would have lost bits


def test_one_batch_call_per_control_step_serves_all_runs(monkeypatch: pytest.MonkeyPatch) -> None:
    env = envs.make("reach", engine="native")
    calls: list[int] = []
    advance = NativePhysics._advance

    def counted(self: NativePhysics, context: object, outputs: object, *arguments: object) -> None:
        calls.append(np.asarray(arguments[0]).reshape(-1, self._row_words).shape[0])
        advance(self, context, outputs, *arguments)

    monkeypatch.setattr(NativePhysics, "_advance", counted)
    actions = jnp.zeros((3, 5, 4, 4))  # three runs, five steps, four environments
    jax.block_until_ready(jax.jit(jax.vmap(lambda a: rolled(env, a)))(actions))
    assert calls == [12] * 5


def test_broken_physics_is_reported() -> None:
    env = envs.make("push", engine="native")
    state = env.reset_to(jnp.array([1.25, 0.6]), jnp.zeros(3))
    row = np.asarray(state.pipeline_state.engine_state).view(np.float64).copy()
    row[1] = np.nan  # the first joint's position follows the time
    broken = state.pipeline_state.replace(engine_state=jnp.asarray(row.view(np.uint32)))
    after = env.step(state.replace(pipeline_state=broken), jnp.zeros(4))
    assert float(after.metrics["physics_warnings"]) > 0
    healthy = env.step(state, jnp.zeros(4))
    assert float(healthy.metrics["physics_warnings"]) == 0


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"name": "slide"}, "env: unknown environment 'slide'"),
        ({"name": "push", "engine": "bullet"}, "engine: unknown engine 'bullet'"),
        ({"name": "pick_and_place", "air_probability": 1.5}, "air_probability: 1.5"),
        ({"name": "push", "air_probability": 0.5}, "air_probability: the object of push"),
        ({"name": "push", "colour": "red"}, "colour: no such field"),
        ({"name": "push", "episode_length": 0}, "episode_length: 0"),
        ({"name": ["push"]}, r"env: unknown environment \['push'\]"),
        ({"name": "push", "distance_threshold": math.inf}, "distance_threshold: inf"),
        ({"name": "push", "distance_threshold": None}, "distance_threshold: None is no number"),
        ({"name": "push", "episode_length": 2.5}, "episode_length: 2.5 is no whole number"),
        ({"name": "push", "episode_length": True}, "episode_length: True is no whole number"),
        ({"name": "pick_and_place", "air_probability": "x"}, "air_probability: 'x' is no number"),
    ],
)
def test_bad_arguments_are_refused_by_name(arguments: dict[str, object], message: str) -> None:
    with pytest.raises((TypeError, ValueError), match=f"^{message}"):
        envs.make(**{"engine": "native", **arguments})  # pyright: ignore[reportArgumentType]


@pytest.mark.parametrize("shape", [(3,), (5,), (1, 4), (4, 1), ()])
def test_an_action_of_another_shape_is_refused(
    env: FetchEnvironment, shape: tuple[int, ...]
) -> None:
    state = jax.eval_shape(env.reset, jax.random.key(0))
    action = jax.ShapeDtypeStruct(shape, jnp.float32)
    with pytest.raises(ValueError, match="action: shape"):
        jax.eval_shape(env.step, state, action)
    batch = jax.eval_shape(jax.vmap(env.reset), jax.random.split(jax.random.key(0), 2))
    with pytest.raises(ValueError, match="action: shape"):
        jax.eval_shape(jax.vmap(env.step), batch, jnp.zeros((2, *shape)))


def test_a_start_of_another_shape_is_refused(env: FetchEnvironment) -> None:
    with pytest.raises(ValueError, match="object_xy: shape"):
        env.reset_to(jnp.zeros(3), jnp.zeros(3))
    with pytest.raises(ValueError, match="desired_goal: shape"):
        env.reset_to(jnp.zeros(2), jnp.zeros(2))


def test_wrappers_of_brax_find_what_they_keep_in_a_state() -> None:
    env = envs.make("reach", engine="native")
    wrapped = EpisodeWrapper(env, 3, 1)
    state = jax.jit(wrapped.reset)(jax.random.key(0))
    step = jax.jit(wrapped.step)
    for number in range(1, 4):
        state = step(state, jnp.zeros(env.action_size))
        assert (state.info["steps"], state.done) == (number, number == 3)
    assert hash(env) != hash(envs.make("reach", engine="native"))
