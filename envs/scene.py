"""The MJCF model of a task, with its names resolved to indices once."""

# mujoco's compiled modules come without stubs.
# pyright: reportAttributeAccessIssue=false

from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np

from cgm_jax.envs.tasks import Task

# Beside this package both in a checkout and in an installed wheel.
ASSETS = Path(__file__).resolve().parents[1] / "assets" / "fetch"


@dataclass(frozen=True)
class Scene:
    """A compiled model and where to find things in it.

    Attributes:
        model: the compiled MJCF.
        home: generalised positions [nq] of the initial pose, from the keyframe "home".
        grip_home: position [3] of the grip site in that pose, metres.
        object_home: position [3] of the object in that pose, or None without an object.
        object_address: index in qpos where the object's position starts, or None.
        blocked_addresses: indices in qpos that are set to 0 before every control step: the
            fingers where the task blocks them, as Gymnasium-Robotics does it.
        sensors: sensor name to its slice of the sensor data.
    """

    model: mujoco.MjModel
    home: np.ndarray
    grip_home: np.ndarray
    object_home: np.ndarray | None
    object_address: int | None
    blocked_addresses: tuple[int, ...]
    sensors: dict[str, slice]

    @property
    def substeps(self) -> int:
        """Physics steps in a control step of 0.04 s."""
        return round(0.04 / self.model.opt.timestep)


def load_scene(task: Task) -> Scene:
    """Compile a task's scene and resolve its names.

    Raises:
        ValueError: the MJCF does not compile, as MuJoCo words it.
    """
    model = mujoco.MjModel.from_xml_path(str(ASSETS / task.scene))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("home").id)
    mujoco.mj_forward(model, data)
    addresses, sizes = model.sensor_adr, model.sensor_dim
    sensors = {
        model.sensor(i).name: slice(int(addresses[i]), int(addresses[i] + sizes[i]))
        for i in range(model.nsensor)
    }
    has_object = task.has_object
    blocked = ("right_finger", "left_finger") if task.fingers_blocked else ()
    return Scene(
        model=model,
        home=data.qpos.copy(),
        grip_home=data.site("grip").xpos.copy(),
        object_home=data.body("object").xpos.copy() if has_object else None,
        object_address=int(model.joint("object").qposadr[0]) if has_object else None,
        blocked_addresses=tuple(int(model.joint(name).qposadr[0]) for name in blocked),
        sensors=sensors,
    )
