"""Goal-conditioned environments: the Fetch tasks, on interchangeable physics engines.

names.py             `make("push", engine="auto")`: names to environments
goal_environment.py  the protocol that `cgm_jax` trains on; implement it to bring your own
goals.py             masked goals, and when they are achieved; numpy_goals.py the same without JAX
fetch.py             the Fetch environment: reset, reset_to, step
tasks.py             what distinguishes reach, push and pick_and_place
mocap_controller.py  from an action to the pose that drags the arm (inverse kinematics)
observations.py      from sensor readings to the Gymnasium-Robotics observation
scene.py             the MJCF model, its names resolved to indices once
rendering.py         frames of a scene and its (masked) goal, without a display
quiet_import.py      Brax's states and MJX, imported without remarks
viewer.py            MuJoCo's viewer on episodes, with a display
gymnasium/           the same tasks for Gymnasium, one by one and batched
hosted/              Gymnasium's goal environments as tasks, in a process of their own
physics/             one protocol, several engines: native (C MuJoCo), mjx, warp

What `__all__` names is imported when it is first asked for: MJX alone takes longer to import than
all else, and `--help`, which reads goals.py on its way, needs none of it.
"""

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from cgm_jax.envs.goal_environment import (
        GoalEnvironment,
        JudgingEnvironment,
        RenderableEnvironment,
        Stage,
        StagedEnvironment,
        StartableEnvironment,
    )
    from cgm_jax.envs.names import ENGINES, TASKS, make

__all__ = [
    "ENGINES",
    "TASKS",
    "GoalEnvironment",
    "JudgingEnvironment",
    "RenderableEnvironment",
    "Stage",
    "StagedEnvironment",
    "StartableEnvironment",
    "make",
]

_PLACES = {
    "ENGINES": "names",
    "TASKS": "names",
    "make": "names",
    "GoalEnvironment": "goal_environment",
    "JudgingEnvironment": "goal_environment",
    "RenderableEnvironment": "goal_environment",
    "Stage": "goal_environment",
    "StagedEnvironment": "goal_environment",
    "StartableEnvironment": "goal_environment",
}


def __getattr__(name: str) -> Any:
    if name not in _PLACES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f"{__name__}.{_PLACES[name]}"), name)
