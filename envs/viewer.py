"""MuJoCo's own viewer on episodes of a Fetch task: a window, in which the camera can be moved."""

# mujoco's compiled modules come without stubs.
# pyright: reportAttributeAccessIssue=false

import sys
import time
import warnings
from collections.abc import Callable, Sequence

import mujoco
import numpy as np

from cgm_jax.envs.rendering import (
    FRAMES_PER_SECOND,
    GREEN,
    RED,
    RenderingError,
    add_shape,
    goal_shapes,
    workspace,
)
from cgm_jax.envs.scene import Scene

CAMERA = (2.0, 135.0, -20.0)
"""Distance from the table in metres, azimuth and elevation in degrees, to begin with."""

NO_DISPLAY = "there is no display here; --video FILE.mp4 needs none"
HELD_SECONDS = 0.5
"""The last state of an episode stays so long, so that its outcome can be seen."""


def check_display() -> None:
    """Find out whether this machine can open a window.

    Raises:
        RenderingError: it cannot; the message is one line and says what to do.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of what glfw then returns
        try:
            import glfw
            from mujoco import viewer

            opened = bool(glfw.init())
        except (ImportError, RuntimeError):  # libraries are missing
            raise RenderingError(NO_DISPLAY) from None
    if not opened:
        raise RenderingError(NO_DISPLAY)
    if sys.platform == "darwin" and viewer._MJPYTHON is None:
        raise RenderingError("on macOS MuJoCo's viewer needs mjpython instead of python")


def play(
    scene: Scene,
    positions: np.ndarray,
    goals: np.ndarray,
    achieved: np.ndarray,
    *,
    goal_radius: float,
    mask: Sequence[float],
    stopped: Callable[[], bool],
) -> None:
    """Show episodes in real time, again and again until the window is closed.

    Args:
        scene: what to draw.
        positions: generalised positions, [T + 1, K, nq].
        goals: desired goals [K, 3], metres.
        achieved: whether the masked goal is, at every step, [K, T + 1] bool.
        goal_radius: the goal is achieved within this, metres.
        mask: 1 keeps an axis of the goal, 0 masks it, [3].
        stopped: asked at every frame whether to end.
    """
    from mujoco import viewer

    model, data = scene.model, mujoco.MjData(scene.model)
    low, high = workspace(model)
    with viewer.launch_passive(model, data, show_left_ui=False, show_right_ui=False) as window:
        visual_scene = window.user_scn
        assert visual_scene is not None
        window.cam.lookat[:] = (low + high) / 2
        window.cam.distance, window.cam.azimuth, window.cam.elevation = CAMERA
        while True:
            for episode, goal in enumerate(goals):
                shapes = goal_shapes(goal, mask, goal_radius, low, high)
                for step, row in enumerate(positions[:, episode]):
                    if stopped() or not window.is_running():
                        return
                    with window.lock():
                        data.qpos[:] = row
                        mujoco.mj_forward(model, data)
                        visual_scene.ngeom = 0
                        for shape in shapes:
                            add_shape(
                                visual_scene, shape, GREEN if achieved[episode, step] else RED
                            )
                    window.sync()
                    last = step == len(positions) - 1
                    time.sleep(1 / FRAMES_PER_SECOND + (HELD_SECONDS if last else 0.0))
