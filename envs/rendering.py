"""Images of a Fetch scene and its goal, off-screen: no display and no GPU needed.

A goal is achieved within a distance of it, so what is drawn is that region, translucent, around
a solid core. A masked axis counts as achieved wherever the object is, so the region extends
along it: a ball for a whole goal, a cylinder around a line where one axis is masked, a slab
around a plane where two are, and all of the workspace where three are (Eppe, Magg, Wermter 2019,
Fig. 1). Red means not achieved, green achieved.
"""

# mujoco's compiled modules come without stubs.
# pyright: reportAttributeAccessIssue=false

import atexit
import numbers
import os
import platform
import weakref
from collections.abc import Sequence
from typing import Any, NamedTuple

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from cgm_jax.envs.scene import Scene

CAMERA = "overview"
FRAMES_PER_SECOND = 25
"""One frame per control step of 0.04 s is real time."""

WORKSPACE_HEIGHT = 0.5
"""Masked axes are drawn over the table and up to this above it (m)."""

RED, GREEN = (0.85, 0.0, 0.25), (0.05, 0.7, 0.15)
EXTRA_GEOMS = 100  # room for the goal and for what MuJoCo draws of its own
HOW_TO_INSTALL = "on Debian or Ubuntu: apt-get install -y libegl1 libgl1-mesa-dri"

_OPEN: "weakref.WeakSet[Renderer]" = weakref.WeakSet()


class RenderingError(RuntimeError):
    """This machine offers no off-screen rendering; the message is one line and says what to do."""


class Shape(NamedTuple):
    """A geom to draw.

    Attributes:
        kind: mjGEOM_SPHERE, mjGEOM_CYLINDER or mjGEOM_BOX.
        size: as MuJoCo has it for that kind: (radius,), (radius, half length) or half sizes [3].
        position: centre [3], metres.
        rotation: matrix [3, 3]; a cylinder extends along its third column.
        opacity: 1 is solid.
    """

    kind: mujoco.mjtGeom
    size: tuple[float, ...]
    position: np.ndarray
    rotation: np.ndarray
    opacity: float


def goal_shapes(
    goal: np.ndarray, mask: Sequence[float], radius: float, low: np.ndarray, high: np.ndarray
) -> list[Shape]:
    """What to draw for a goal, the solid core first.

    Args:
        goal: [3], metres.
        mask: 1 keeps an axis, 0 masks it, [3].
        radius: the goal is achieved within this, metres.
        low: least corner [3] of the workspace, over which masked axes extend.
        high: greatest corner [3].
    """
    masked = np.asarray(mask) == 0
    centre = np.where(masked, (low + high) / 2, goal)
    reach = (high - low) / 2
    if not masked.any():
        return [
            Shape(mujoco.mjtGeom.mjGEOM_SPHERE, (size,), centre, np.eye(3), opacity)
            for size, opacity in ((0.02, 1.0), (radius, 0.25))
        ]
    if masked.sum() == 1:
        axis = int(np.argmax(masked))
        along = np.eye(3)[:, [(axis + 1) % 3, (axis + 2) % 3, axis]]
        return [
            Shape(mujoco.mjtGeom.mjGEOM_CYLINDER, (size, reach[axis]), centre, along, opacity)
            for size, opacity in ((0.005, 1.0), (radius, 0.25))
        ]
    thicknesses = ((0.002, 0.35), (radius, 0.2)) if masked.sum() == 2 else ((radius, 0.12),)
    return [
        Shape(
            mujoco.mjtGeom.mjGEOM_BOX,
            tuple(np.where(masked, reach, thickness)),
            centre,
            np.eye(3),
            opacity,
        )
        for thickness, opacity in thicknesses
    ]


class Renderer:
    """Draws states of one scene. A context manager; `close` frees what it holds."""

    def __init__(
        self, scene: Scene, goal_radius: float, width: int = 640, height: int = 480
    ) -> None:
        """Open a drawing surface.

        Args:
            scene: what to draw.
            goal_radius: the goal is achieved within this, metres.
            width: of a frame, pixels.
            height: of a frame, pixels.

        Raises:
            ValueError: a frame of no size, or larger than the model's off-screen buffer.
            RenderingError: this machine cannot render.
        """
        check_size(scene, width, height)
        model = scene.model
        self._model, self._data = model, mujoco.MjData(model)
        self._goal_radius = goal_radius
        self._low, self._high = workspace(model)
        self._area = mujoco.MjrRect(0, 0, width, height)
        self._visual_scene = mujoco.MjvScene(model, maxgeom=model.ngeom + EXTRA_GEOMS)
        self._camera = mujoco.MjvCamera()
        self._camera.type = mujoco.mjtCamera.mjCAMERA_FIXED
        self._camera.fixedcamid = model.camera(CAMERA).id
        self._surface, self._context = _open_surface(model, width, height)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN.value, self._context)
        _OPEN.add(self)
        # Last registered is first called: before MuJoCo's handler takes EGL down.
        atexit.unregister(_close_all)
        atexit.register(_close_all)

    def frame(
        self,
        positions: np.ndarray,
        goal: ArrayLike,
        *,
        achieved: bool,
        mask: Sequence[float] = (1, 1, 1),
    ) -> np.ndarray:
        """A frame, [height, width, 3] uint8.

        Args:
            positions: generalised positions [nq], as `Physics.positions` gives them.
            goal: the desired goal [3], metres.
            achieved: whether it is, under its mask.
            mask: 1 keeps an axis of the goal, 0 masks it, [3].
        """
        self._data.qpos[:] = positions
        mujoco.mj_kinematics(self._model, self._data)
        mujoco.mj_camlight(self._model, self._data)
        everything = mujoco.mjtCatBit.mjCAT_ALL.value
        mujoco.mjv_updateScene(
            self._model,
            self._data,
            mujoco.MjvOption(),
            None,
            self._camera,
            everything,
            self._visual_scene,
        )
        # The shadow of a slab would only darken the table.
        self._visual_scene.flags[mujoco.mjtRndFlag.mjRND_SHADOW] = sum(mask) > 1
        shapes = goal_shapes(np.asarray(goal), mask, self._goal_radius, self._low, self._high)
        for shape in shapes:
            add_shape(self._visual_scene, shape, GREEN if achieved else RED)
        pixels = np.empty((self._area.height, self._area.width, 3), np.uint8)
        self._surface.make_current()
        mujoco.mjr_render(self._area, self._visual_scene, self._context)
        mujoco.mjr_readPixels(pixels, None, self._area, self._context)
        return np.flipud(pixels)  # OpenGL counts rows from below

    def close(self) -> None:
        """Free the drawing surface. Any number of times."""
        if self._context is not None:
            self._surface.make_current()  # what is freed is the current one's, whosever that is
            self._context.free()
            self._surface.free()
            self._context = None

    def __enter__(self) -> "Renderer":
        """The renderer itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """Free the drawing surface."""
        self.close()


def add_shape(
    visual_scene: mujoco.MjvScene, shape: Shape, colour: tuple[float, float, float]
) -> None:
    """Add a shape to what MuJoCo is to draw."""
    geom = visual_scene.geoms[visual_scene.ngeom]
    size = np.zeros(3)
    size[: len(shape.size)] = shape.size
    mujoco.mjv_initGeom(
        geom,
        shape.kind.value,
        size,
        shape.position,
        shape.rotation.ravel(),
        np.array([*colour, shape.opacity], np.float32),
    )
    geom.emission = 0.3
    visual_scene.ngeom += 1


def workspace(model: mujoco.MjModel) -> tuple[np.ndarray, np.ndarray]:
    """Least and greatest corner [3] of the workspace, over which masked axes extend."""
    table = model.geom("table")
    low = table.pos + table.size * (-1, -1, 1)
    return low, table.pos + table.size + (0, 0, WORKSPACE_HEIGHT)


def check_size(scene: Scene, width: int, height: int) -> None:
    """Check the size of a frame without opening anything.

    Raises:
        TypeError: a size is no integer.
        ValueError: a frame of no size, or larger than the model's off-screen buffer.
    """
    limits = scene.model.vis.global_
    for name, size, limit in (
        ("width", width, limits.offwidth),
        ("height", height, limits.offheight),
    ):
        if not isinstance(size, numbers.Integral) or isinstance(size, bool):
            raise TypeError(f"{name}: {size!r} is no integer")
        if not 1 <= size <= limit:
            raise ValueError(f"{name}: {size} is not within [1, {limit}]")


def check_rendering() -> None:
    """Find out whether this machine can render.

    Raises:
        RenderingError: it cannot.
    """
    surface, context = _open_surface(mujoco.MjModel.from_xml_string("<mujoco/>"), 64, 64)
    context.free()
    surface.free()


def _open_surface(model: mujoco.MjModel, width: int, height: int) -> tuple[Any, Any]:
    """An OpenGL context, and MuJoCo's own with what it takes to draw `model`.

    By EGL, which needs no display, unless MUJOCO_GL asks for another.

    Raises:
        RenderingError: none can be had, because libraries or drivers are missing.
    """
    try:
        if platform.system() == "Linux" and not os.environ.get("MUJOCO_GL"):
            from mujoco.egl import GLContext
        else:
            from mujoco.rendering.classic.gl_context import GLContext
        surface = GLContext(width, height)
        surface.make_current()
        return surface, mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_100.value)
    except Exception as error:  # from ImportError to OpenGL's own kinds
        reason = str(error).strip().partition("\n")[0]
        raise RenderingError(
            f"no off-screen rendering here ({type(error).__name__}: {reason}); {HOW_TO_INSTALL}"
        ) from error


def _close_all() -> None:
    """Free the surfaces that nobody has closed, while that is still possible."""
    for renderer in list(_OPEN):
        renderer.close()
