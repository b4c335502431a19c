"""What is measured, and on what: runs of the preset `cpu`, on a CPU."""

import os

import jax

from cgm_jax.config.fields import SettingError
from cgm_jax.config.grid import Group, build_groups


def choose_cpu() -> None:
    """Have JAX compute on the CPU, here and in programs started from here, GPU or not.

    Raises:
        SettingError: JAX_PLATFORMS names something else.
    """
    asked = os.environ.get("JAX_PLATFORMS") or "cpu"
    if asked != "cpu":
        raise SettingError(f"JAX_PLATFORMS: what is measured here is the CPU, not {asked!r}")
    os.environ["JAX_PLATFORMS"] = "cpu"
    jax.config.update("jax_platforms", "cpu")


def cpu_group(env: str, runs: int = 1) -> Group:
    """Runs of the cpu preset, which differ in their seed."""
    grid = {"env": [env], "seed": list(range(runs))}
    return build_groups("cpu", {**grid, "replay_transitions": [100_000]})[0]
