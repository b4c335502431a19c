"""Render the pick-and-place scene: `MUJOCO_GL=egl python experiments/scene_picture.py OUT.png`."""

import sys

import matplotlib.image
import mujoco
import numpy as np

from envs.scene import load_scene
from envs.tasks import TASKS

# pyright: reportAttributeAccessIssue=false


def render() -> np.ndarray:
    """The home pose with the block on the table and the goal in the air, [height, width, 3]."""
    model = load_scene(TASKS["pick_and_place"]).model
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("home").id)
    data.joint("object").qpos[:2] = 1.38, 0.62
    model.site("target").pos[:] = 1.42, 0.66, 0.62
    mujoco.mj_forward(model, data)
    with mujoco.Renderer(model, height=480, width=640) as renderer:
        renderer.update_scene(data, camera="overview")
        return renderer.render()


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    matplotlib.image.imsave(sys.argv[1], render())
