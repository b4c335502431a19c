"""Goal-conditioned environments: the Fetch tasks, on interchangeable physics engines.

make.py              `make("push", engine="auto")`: names to environments
goal_environment.py  the protocol that `cgm_jax` trains on; implement it to bring your own
fetch.py             the Fetch environment: reset, reset_to, step
tasks.py             what distinguishes reach, push and pick_and_place
mocap_controller.py  from an action to the pose that drags the arm (inverse kinematics)
observations.py      from sensor readings to the Gymnasium-Robotics observation
scene.py             the MJCF model, its names resolved to indices once
rendering.py         frames of a scene and its (masked) goal, without a display
viewer.py            MuJoCo's viewer on episodes, with a display
gymnasium/           the same tasks for Gymnasium, one by one and batched
hosted/              Gymnasium's goal environments as tasks, in a process of their own
physics/             one protocol, several engines: native (C MuJoCo), mjx, warp
"""

from cgm_jax.envs import quiet_import as _quiet_import  # noqa: F401 -- before anything of brax
from cgm_jax.envs.goal_environment import (
    GoalEnvironment,
    JudgingEnvironment,
    RenderableEnvironment,
    StartableEnvironment,
)
from cgm_jax.envs.make import ENGINES, TASKS, make

__all__ = [
    "ENGINES",
    "TASKS",
    "GoalEnvironment",
    "JudgingEnvironment",
    "RenderableEnvironment",
    "StartableEnvironment",
    "make",
]
