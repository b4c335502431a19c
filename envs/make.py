"""From a name to an environment."""

import dataclasses
from typing import Any

from envs.fetch import FetchEnvironment
from envs.physics.choose import ENGINES, start_engine
from envs.physics.deferred import DeferredPhysics
from envs.scene import load_scene
from envs.tasks import TASKS

__all__ = ["ENGINES", "TASKS", "make"]


def make(
    name: str, engine: str = "auto", *, deferred: bool = False, **fields: Any
) -> FetchEnvironment:
    """Make a Fetch environment.

    Args:
        name: "reach", "push" or "pick_and_place".
        engine: "native" (C MuJoCo, CPU), "mjx" (JAX), "warp" (NVIDIA GPU), or "auto".
        deferred: starts the engine, and with it JAX, at its first use instead of now. What
            the engine finds wrong with JAX's device is then said there.
        **fields: fields of `FetchEnvironment` other than its defaults, such as
            `air_probability=0.5` for Gymnasium-Robotics' pick-and-place goals.

    Raises:
        ValueError: unknown name, engine or field, or an engine that is not installed.
    """
    if name not in TASKS:
        raise ValueError(f"env: unknown environment {name!r}; choose from {', '.join(TASKS)}")
    task = TASKS[name]
    settable = {field.name for field in dataclasses.fields(FetchEnvironment)}
    settable -= {"task", "scene", "physics"}
    if unknown := sorted(set(fields) - settable):
        raise ValueError(f"{unknown[0]}: no such field; choose from {', '.join(sorted(settable))}")
    if fields.get("air_probability", 0.0) > 0.0 and (task.fingers_blocked or not task.has_object):
        raise ValueError(f"air_probability: the object of {name} cannot be lifted into the air")
    scene = load_scene(task)
    fields.setdefault("air_probability", task.air_probability)
    physics = DeferredPhysics(engine, scene) if deferred else start_engine(engine, scene)
    return FetchEnvironment(task, scene, physics, **fields)
