"""From a name to an environment."""

import dataclasses
import numbers
from collections.abc import Callable
from typing import Any

from cgm_jax.envs.fetch import FetchEnvironment
from cgm_jax.envs.physics.choose import ENGINES, start_engine
from cgm_jax.envs.physics.deferred import DeferredPhysics
from cgm_jax.envs.physics.protocol import Physics
from cgm_jax.envs.scene import Scene, load_scene
from cgm_jax.envs.tasks import TASKS

__all__ = ["ENGINES", "TASKS", "make"]


def make(name: str, engine: str = "auto", **fields: Any) -> FetchEnvironment:
    """Make a Fetch environment.

    Args:
        name: "reach", "push" or "pick_and_place".
        engine: "native" (C MuJoCo, CPU), "mjx" (JAX), "warp" (NVIDIA GPU), or "auto".
        **fields: fields of `FetchEnvironment` other than its defaults, such as
            `air_probability=0.5` for Gymnasium-Robotics' pick-and-place goals.

    Raises:
        TypeError: a field is no number of its kind.
        ValueError: unknown name, engine or field, a field out of its range, or an engine that is
            not installed.
    """
    return _make(name, fields, lambda scene: start_engine(engine, scene))


def make_deferred(name: str, engine: str = "auto", **fields: Any) -> FetchEnvironment:
    """As `make`, but the engine, and with it JAX, starts at its first use.

    What the engine finds wrong with JAX's device is said there.
    """
    return _make(name, fields, lambda scene: DeferredPhysics(engine, scene))


def _make(
    name: str, fields: dict[str, Any], physics: Callable[[Scene], Physics]
) -> FetchEnvironment:
    if not isinstance(name, str) or name not in TASKS:
        raise ValueError(f"env: unknown environment {name!r}; choose from {', '.join(TASKS)}")
    task = TASKS[name]
    settable = {field.name for field in dataclasses.fields(FetchEnvironment)}
    settable -= {"task", "scene", "physics"}
    if unknown := sorted(set(fields) - settable):
        raise ValueError(f"{unknown[0]}: no such field; choose from {', '.join(sorted(settable))}")
    in_air = fields.get("air_probability", 0)
    can_lift = task.has_object and not task.fingers_blocked
    if isinstance(in_air, numbers.Real) and float(in_air) > 0.0 and not can_lift:
        raise ValueError(f"air_probability: the object of {name} cannot be lifted into the air")
    scene = load_scene(task)
    fields = {"air_probability": task.air_probability, **fields}
    return FetchEnvironment(task, scene, physics(scene), **fields)
