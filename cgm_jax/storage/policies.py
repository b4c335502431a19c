"""Trained policies as files of plain arrays."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp
import numpy as np

from cgm_jax.agents.networks import Parameters, apply_actor
from cgm_jax.loop.normaliser import Normaliser, network_input
from cgm_jax.storage.arrays import read_arrays

if TYPE_CHECKING:
    from brax.training.acme.running_statistics import NestedMeanStd

MAX_POLICY_BYTES = 2**30

FORMAT = 2
"""Of policy files. Format 1 had no such entry, and clipped raw values to +-`raw_limit`."""


OPTIONAL = ("raw_limit", "mask_weights")
"""Arrays of the first format, and of policies that see the mask."""


def policy_arrays(
    actor: Parameters, statistics: Normaliser, *, mask_input: bool = False
) -> dict[str, np.ndarray]:
    """All arrays that the deterministic actor of one run needs.

    Args:
        actor: its parameters, `Agent.actor`.
        statistics: its normaliser.
        mask_input: whether it sees which goal dimensions are masked.

    Returns:
        `layer_<i>_kernel` [in, out] and `layer_<i>_bias` [out]; `observation_mean`,
        `observation_std`, `goal_mean`, `goal_std`; the scalar `normalised_limit` to which
        normalised inputs are clipped; and `format`. Whatever else the networks see is 0 for the
        full goal, and left out; but `mask_weights` [n, out] of the first layer, with
        `mask_input`, serve masked goals.
    """
    arrays: dict[str, Any] = {"format": FORMAT, "normalised_limit": statistics.limit}
    for layer, parameters in actor["params"].items():
        for name, value in parameters.items():
            arrays[f"{layer}_{name}"] = value
    for kind in ("observation", "goal"):
        running = getattr(statistics, kind)
        arrays[f"{kind}_mean"], arrays[f"{kind}_std"] = running.mean, running.std
    goal = arrays["goal_mean"].shape[-1]
    seen = arrays["observation_mean"].shape[-1] + goal
    whole = arrays["layer_0_kernel"]
    arrays["layer_0_kernel"] = whole[:seen]
    if mask_input:
        arrays["mask_weights"] = whole[seen : seen + goal]
    return {name: np.asarray(value, np.float32) for name, value in arrays.items()}


def load_policy(
    path: Path,
    observation_size: int | None = None,
    goal_size: int | None = None,
    action_size: int | None = None,
) -> dict[str, np.ndarray]:
    """Read a policy file. Never runs code from it.

    Args:
        path: the file.
        observation_size: of the environment that it is for; None if that is not known.
        goal_size: as well.
        action_size: as well.

    Returns:
        The arrays that `act` needs, float32.

    Raises:
        ValueError: the file is no policy, or none for such an environment: unreadable, or arrays
            missing, not finite numbers, or of other sizes. The message names the file.
    """
    try:
        arrays = read_arrays(path, MAX_POLICY_BYTES)
    except ValueError as error:
        raise ValueError(f"not a readable policy file: {error}") from None
    try:
        used = _numbers(arrays)
        _check_layers(used)
        sizes = {
            "observations": (used["observation_mean"].size, observation_size),
            "goals": (used["goal_mean"].size, goal_size),
            "actions": (used[f"layer_{layer_count(used) - 1}_bias"].size, action_size),
        }
        for kind, (size, wanted) in sizes.items():
            if wanted not in (None, size):
                raise ValueError(f"made for {kind} of size {size}, not {wanted}")
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None
    return used


def layer_count(arrays: Mapping[str, Any]) -> int:
    """How many layers the actor of a policy file's arrays has."""
    return sum(name.endswith("_kernel") for name in arrays)


def _numbers(arrays: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """The arrays that a policy needs, all finite float32."""
    version = arrays.get("format", np.array(1.0))
    if version.ndim or version.dtype.kind not in "fiu" or version not in (1, FORMAT):
        shown = version.item() if version.size == 1 else "of several numbers"
        raise ValueError(f"a policy file of a newer format, {shown!r:.40}")
    needed = {
        f"layer_{i}_{part}"
        for i in range(max(1, layer_count(arrays)))
        for part in ("kernel", "bias")
    }
    needed |= {f"{kind}_{part}" for kind in ("observation", "goal") for part in ("mean", "std")}
    needed |= {"normalised_limit"}
    if missing := sorted(needed - set(arrays)):
        raise ValueError(f"not a policy file, it lacks {', '.join(missing)}")
    used = {}
    for name in sorted(needed | ({*OPTIONAL} & set(arrays))):
        if not np.issubdtype(arrays[name].dtype, np.floating):
            raise ValueError(f"not a policy file, {name} holds no real numbers")
        with np.errstate(over="ignore"):
            used[name] = arrays[name].astype(np.float32)
        if not np.isfinite(used[name]).all():
            raise ValueError(f"{name} holds numbers that are not finite")
    return used


def _check_layers(arrays: Mapping[str, np.ndarray]) -> None:
    """Check that what a policy needs fits together."""
    for kind in ("observation", "goal"):
        mean, std = arrays[f"{kind}_mean"], arrays[f"{kind}_std"]
        if mean.ndim != 1 or std.shape != mean.shape:
            raise ValueError(f"not a policy file, {kind}_std has shape {std.shape}")
        if not (std > 0).all():
            raise ValueError(f"{kind}_std holds numbers that are not above 0")
    for name in {"normalised_limit", "raw_limit"} & set(arrays):
        if arrays[name].ndim or not arrays[name] > 0:
            raise ValueError(f"{name} is not one number above 0")
    width = arrays["observation_mean"].size + arrays["goal_mean"].size
    shown = (arrays["goal_mean"].size, arrays["layer_0_bias"].size)
    if "mask_weights" in arrays and arrays["mask_weights"].shape != shown:
        raise ValueError(f"not a policy file, mask_weights do not have shape {shown}")
    for i in range(layer_count(arrays)):
        kernel, bias = arrays[f"layer_{i}_kernel"], arrays[f"layer_{i}_bias"]
        if bias.ndim != 1 or not bias.size or kernel.shape != (width, bias.size):
            raise ValueError(f"not a policy file, layer {i} has shape {kernel.shape}")
        width = bias.size


def act(
    arrays: Mapping[str, jax.Array | np.ndarray],
    observation: jax.Array,
    goal: jax.Array,
    mask: jax.Array | np.ndarray | None = None,
) -> jax.Array:
    """The deterministic action [..., a] of a policy file's arrays, in JAX.

    Args:
        arrays: as `load_policy` returns them.
        observation: [..., observation_size].
        goal: [..., n], the desired goal, masked if a mask is given.
        mask: of all the goals, [n]; None for the full goal.
    """
    layers = layer_count(arrays)
    parameters = {
        f"layer_{i}": {
            part: jnp.asarray(arrays[f"layer_{i}_{part}"]) for part in ("kernel", "bias")
        }
        for i in range(layers)
    }
    if mask is not None and "mask_weights" in arrays:
        parameters["layer_0"]["bias"] += (1.0 - mask) @ arrays["mask_weights"]
    statistics = Normaliser(
        observation=_mean_std(arrays, "observation"),  # pyright: ignore[reportArgumentType]
        goal=_mean_std(arrays, "goal"),  # pyright: ignore[reportArgumentType]
        limit=jnp.asarray(arrays["normalised_limit"]),
    )
    if "raw_limit" in arrays:  # of format 1
        raw_limit = arrays["raw_limit"]
        observation, goal = (jnp.clip(x, -raw_limit, raw_limit) for x in (observation, goal))
    inputs = network_input(statistics, observation, goal)
    return apply_actor({"params": parameters}, inputs)


def _mean_std(arrays: Mapping[str, jax.Array | np.ndarray], kind: str) -> "NestedMeanStd":
    from brax.training.acme.running_statistics import NestedMeanStd

    return NestedMeanStd(mean=arrays[f"{kind}_mean"], std=arrays[f"{kind}_std"])
