"""Engines by name, and which one "auto" means."""

import importlib.util

from cgm_jax.envs.physics.protocol import Physics
from cgm_jax.envs.scene import Scene

ENGINES = ("auto", "native", "mjx", "warp")


def check_engine(name: str) -> None:
    """Check an engine's name without starting anything.

    Raises:
        ValueError: the name is unknown, or the engine is not installed.
    """
    if name not in ENGINES:
        raise ValueError(f"engine: unknown engine {name!r}; choose from {', '.join(ENGINES)}")
    if name == "warp" and not has_warp():
        raise ValueError("engine: warp needs the package warp-lang, which is not installed")


def choose_engine(name: str) -> str:
    """Resolve "auto" by platform: native on a CPU; on a GPU warp where installed, else mjx.

    Raises:
        ValueError: as `check_engine`.
    """
    check_engine(name)
    if name != "auto":
        return name

    import jax

    platform = jax.default_backend()
    if platform == "cpu":
        return "native"
    return "warp" if has_warp() and platform == "gpu" else "mjx"


def has_warp() -> bool:
    """Whether the package warp-lang is installed."""
    return importlib.util.find_spec("warp") is not None


def start_engine(name: str, scene: Scene) -> Physics:
    """Build an engine for a scene; its own dependencies are imported only here.

    Raises:
        ValueError: the engine is unknown, not installed, or cannot run on JAX's device.
    """
    name = choose_engine(name)
    if name == "native":
        import jax

        if jax.default_backend() != "cpu":
            raise ValueError("engine: native needs JAX on a CPU; set JAX_PLATFORMS=cpu")
        from cgm_jax.envs.physics.native import NativePhysics

        return NativePhysics(scene)

    if name == "warp":
        from cgm_jax.envs.physics.warp import WarpPhysics

        return WarpPhysics(scene)
    from cgm_jax.envs.physics.mjx import MjxPhysics

    return MjxPhysics(scene)
