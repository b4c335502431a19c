import mujoco
import numpy as np
import pytest

from cgm_jax.envs.physics.mjx import MjxPhysics, Motion
from cgm_jax.envs.physics.native import NativePhysics
from cgm_jax.envs.physics.protocol import PhysicsState
from cgm_jax.envs.rendering import Renderer, Shape, goal_shapes
from cgm_jax.envs.scene import Scene, load_scene
from cgm_jax.envs.tasks import TASKS
from tests.envs.surface import can_render

# pyright: reportAttributeAccessIssue=false

LOW, HIGH = np.array([1.0, 0.4, 0.4]), np.array([1.6, 1.2, 0.9])
GOAL = np.array([1.3, 0.7, 0.5])


def inside(shape: Shape, point: np.ndarray) -> bool:
    """Whether a point lies within a shape."""
    kind, size, position, rotation, _ = shape
    x, y, z = rotation.T @ (point - position)
    if kind == mujoco.mjtGeom.mjGEOM_SPHERE:
        return x * x + y * y + z * z < size[0] ** 2
    if kind == mujoco.mjtGeom.mjGEOM_CYLINDER:
        return x * x + y * y < size[0] ** 2 and abs(z) < size[1]
    assert kind == mujoco.mjtGeom.mjGEOM_BOX
    return bool((np.abs([x, y, z]) < size).all())


@pytest.mark.parametrize("index", range(8))
def test_what_is_drawn_is_where_the_masked_goal_is_achieved(index: int) -> None:
    mask = [index >> 2 & 1, index >> 1 & 1, index & 1]
    *_, region = goal_shapes(GOAL, mask, 0.05, LOW, HIGH)
    points = np.random.default_rng(0).uniform(LOW, HIGH, (4000, 3))
    # Half of the points near the goal, so that few-masked regions are met at all.
    points[::2] = GOAL + (points[::2] - GOAL) * 0.15
    drawn = [inside(region, point) for point in points]
    distance = np.sqrt((((points - GOAL) * mask) ** 2).sum(axis=1))
    np.testing.assert_array_equal(drawn, distance < 0.05)
    assert 0.02 < np.mean(drawn) < 0.95 or index == 0


def test_a_line_runs_along_its_masked_axis_and_a_plane_is_thin() -> None:
    line, _ = goal_shapes(GOAL, [0, 1, 1], 0.05, LOW, HIGH)
    assert line.kind == mujoco.mjtGeom.mjGEOM_CYLINDER
    assert line.size == (0.005, pytest.approx(0.3))
    np.testing.assert_allclose(line.position, [1.3, 0.7, 0.5])  # 1.3 is the workspace's middle
    np.testing.assert_allclose(line.rotation[:, 2], [1, 0, 0])
    assert np.linalg.det(line.rotation) == pytest.approx(1)
    plane, _ = goal_shapes(GOAL, [0, 0, 1], 0.05, LOW, HIGH)
    assert plane.kind == mujoco.mjtGeom.mjGEOM_BOX
    np.testing.assert_allclose(plane.size, [0.3, 0.4, 0.002])
    np.testing.assert_allclose(plane.position, [1.3, 0.8, 0.5])
    assert len(goal_shapes(GOAL, [0, 0, 0], 0.05, LOW, HIGH)) == 1  # no core: anything goes


def test_positions_are_those_that_a_simulation_was_started_at() -> None:
    scene = load_scene(TASKS["push"])
    rows = scene.home + np.linspace(0, 1e-3, 6)[:, None]
    native, blank = NativePhysics(scene), np.zeros(0)
    words = np.zeros((6, native._row_words // 2))
    words[:, 1 : 1 + scene.model.nq] = rows  # after the time
    state = PhysicsState(words.view(np.uint32).reshape(2, 3, -1), blank, blank)  # pyright: ignore
    np.testing.assert_array_equal(native.positions(state), rows.reshape(2, 3, -1))
    started = native.positions(native.start(scene.home.astype(np.float32)))  # pyright: ignore
    np.testing.assert_array_equal(started, scene.home.astype(np.float32))
    motion = Motion(rows.astype(np.float32), blank, blank)  # pyright: ignore
    actual = MjxPhysics(scene).positions(PhysicsState(motion, blank, blank))  # pyright: ignore
    np.testing.assert_array_equal(actual, rows.astype(np.float32))


def share(frame: np.ndarray, colour: str) -> float:
    """Share of pixels that are clearly of a colour; the scene has no red or green of its own."""
    red, green, blue = (frame[..., i].astype(int) for i in range(3))
    if colour == "green":
        return float(np.mean((green > red + 50) & (green > blue + 50)))
    return float(np.mean((red > green + 90) & (red > blue + 50)))


@pytest.fixture(scope="module")
def reach() -> Scene:
    if not can_render():
        pytest.skip("this machine has no off-screen rendering")
    return load_scene(TASKS["reach"])  # without the orange block


def test_the_goal_is_red_and_turns_green_when_achieved(reach: Scene) -> None:
    goal = np.array([1.35, 0.6, 0.6])
    with Renderer(reach, 0.05, 320, 240) as renderer:
        pending = renderer.frame(reach.home, goal, achieved=False)
        achieved = renderer.frame(reach.home, goal, achieved=True)
        plane = renderer.frame(reach.home, goal, achieved=True, mask=[0, 0, 1])
    assert pending.shape == (240, 320, 3)
    assert share(pending, "red") > 0.001 > share(pending, "green")
    assert share(achieved, "green") > 0.001 > share(achieved, "red")
    assert share(plane, "green") > 10 * share(achieved, "green")


def test_the_arm_is_drawn_where_it_is(reach: Scene) -> None:
    lifted = reach.home.copy()
    lifted[1] -= 0.5  # the shoulder, up
    away = np.array([0.0, 0.0, -1.0])
    with Renderer(reach, 0.05, 320, 240) as renderer:
        home = renderer.frame(reach.home, away, achieved=False).astype(int)
        moved = renderer.frame(lifted, away, achieved=False)
    changed = np.max(np.abs(home - moved), axis=-1) > 40
    assert 0.02 < changed.mean() < 0.3
    assert not changed[-20:].any()  # the table's front and the floor


@pytest.mark.parametrize("closed", [0, 1])
def test_closing_a_renderer_leaves_others_as_they_are(reach: Scene, closed: int) -> None:
    renderers = [Renderer(reach, 0.05, 160, 120) for _ in range(2)]
    before = [one.frame(reach.home, GOAL, achieved=False) for one in renderers]
    np.testing.assert_array_equal(before[0], before[1])
    renderers.pop(closed).close()
    with renderers[0] as other:
        np.testing.assert_array_equal(other.frame(reach.home, GOAL, achieved=False), before[0])
    assert before[0].mean() > 50


def test_frames_larger_than_the_buffer_are_refused(reach: Scene) -> None:
    with pytest.raises(ValueError, match=r"width: 1281 is not within \[1, 1280\]"):
        Renderer(reach, 0.05, 1281, 480)
