"""Environments under test, and episodes of fixed actions."""

from typing import Any

import gymnasium
import jax.numpy as jnp
import numpy as np

import cgm_jax  # noqa: F401 -- registers the environments

NAMES = ("FetchReach", "FetchPush", "FetchPickAndPlace")
IDS = tuple(f"cgm_jax/{name}-v0" for name in NAMES)


def make(name: str, **arguments: Any) -> Any:
    return gymnasium.make(f"cgm_jax/{name}-v0", **arguments)


def make_vec(name: str, num_envs: int, **arguments: Any) -> Any:
    return gymnasium.make_vec(f"cgm_jax/{name}-v0", num_envs=num_envs, **arguments)


def episode(env: Any, seed: int, steps: int = 10) -> list[dict[str, Any]]:
    """Observations under fixed actions."""
    generator = np.random.default_rng(5)
    first, _ = env.reset(seed=seed)
    actions = generator.uniform(-1, 1, (steps, 4)).astype(np.float32)
    return [first, *(env.step(action)[0] for action in actions)]


def broken(state: Any) -> Any:
    """The state with a joint at no number."""
    row = np.array(state.pipeline_state.engine_state).view(np.float64).copy()
    row[..., 1] = np.nan
    words = jnp.asarray(row.view(np.uint32))
    return state.replace(pipeline_state=state.pipeline_state.replace(engine_state=words))


def assert_same_observations(one: list[dict[str, Any]], other: list[dict[str, Any]]) -> None:
    """Equal in every bit."""
    for a, b in zip(one, other, strict=True):
        assert list(a) == list(b)
        for name in a:
            np.testing.assert_array_equal(a[name], b[name])
