"""A sweep of two policies on reach whose success is known."""

import dataclasses
from pathlib import Path

import numpy as np

from cgm_jax.config.grid import Group, run_of
from cgm_jax.config.settings import Settings
from cgm_jax.storage.run_directory import RunDirectory

REACH = Settings(env="reach", engine="native")


def reaching_policy(gain: float) -> dict[str, np.ndarray]:
    """One layer that moves the grip by tanh(gain * (goal - grip))."""
    kernel = np.zeros((13, 4))
    kernel[:3, :3], kernel[10:, :3] = -gain * np.eye(3), gain * np.eye(3)
    arrays = {"layer_0_kernel": kernel, "layer_0_bias": np.zeros(4)}
    for name, size in (("observation", 10), ("goal", 3)):
        arrays |= {f"{name}_mean": np.zeros(size), f"{name}_std": np.ones(size)}
    arrays |= {"normalised_limit": np.array(5.0)}
    return {name: array.astype(np.float32) for name, array in arrays.items()}


def reaching_runs(path: Path) -> RunDirectory:
    """Two runs: the policy of `still` stands still, that of `straight` goes to the goal."""
    values = dataclasses.asdict(REACH)
    runs = tuple(run_of(name, values)[1] for name in ("still", "straight"))
    with RunDirectory.claimed(path, fresh=True) as directory:
        directory.config.write([Group(REACH, runs)], "smoke", "cpu")
        for run, gain in zip(runs, (0.0, 15.0), strict=True):
            directory.write_policy(run, reaching_policy(gain))
    return directory
