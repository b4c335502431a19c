"""Engines by name, and which one "auto" means."""

import importlib.util
from collections.abc import Mapping
from types import MappingProxyType

from cgm_jax.envs.physics.protocol import Physics
from cgm_jax.envs.scene import Scene

ENGINES = ("auto", "native", "mjx", "warp")

COMPILER_OPTIONS: Mapping[str, Mapping[str, bool]] = {
    **dict.fromkeys(ENGINES, MappingProxyType({})),
    "mjx": {"xla_cpu_use_fusion_emitters": False},
}
"""XLA's options for programs that have an engine in them, by its name; see `Physics`.

On a CPU XLA's fusion emitters take minutes to compile the vmapped kinematics of an arm, and what
they make runs a hundred times slower. Network updates are 7 % slower without them, so that only
programs with this engine do without. The option has no meaning elsewhere, and "auto" is never MJX
on a CPU.
"""


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
