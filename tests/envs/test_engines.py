"""MJX against C MuJoCo, in a process of its own: MJX on a CPU needs its own compiler flag."""

import os
import subprocess
import sys

import pytest

from envs.physics.mjx import CPU_FLAG

PROGRAM = """
import sys
import jax, jax.numpy as jnp, numpy as np
import envs

task = sys.argv[1]
actions = jax.random.uniform(jax.random.key(5), (20, 2, 4), minval=-1.0, maxval=1.0)
# Free motion: up first, so that nothing is touched, and then about.
actions = actions.at[:3].set(jnp.array([0.0, 0.0, 1.0, 0.0]))
grips = {}
for engine in ("native", "mjx"):
    env = envs.make(task, engine=engine)
    reset = lambda xy: env.reset_to(xy, jnp.array([1.3, 0.7, 0.6]))
    state = jax.jit(jax.vmap(reset))(jnp.array([[1.2, 0.65], [1.45, 0.85]]))
    step, path = jax.jit(jax.vmap(env.step)), [state.obs["observation"]]
    for action in actions:
        state = step(state, action)
        path.append(state.obs["observation"])
    grips[engine] = np.array(path)
difference = np.abs(grips["mjx"] - grips["native"])
print("grip", difference[..., :3].max(), "object", difference[..., 3:6].max())
print("moved", np.ptp(grips["native"][..., :3], axis=0).min())
"""


def largest_differences(task: str) -> tuple[float, float, float]:
    environment = {**os.environ, "XLA_FLAGS": CPU_FLAG}
    result = subprocess.run(
        [sys.executable, "-c", PROGRAM, task],
        capture_output=True,
        text=True,
        timeout=580,
        env=environment,
        check=False,
    )
    assert result.returncode == 0, result.stderr
    words = result.stdout.split()
    return tuple(float(words[words.index(name) + 1]) for name in ("grip", "object", "moved"))  # pyright: ignore


def test_mjx_and_native_agree_over_twenty_control_steps() -> None:
    grip, _, moved = largest_differences("reach")  # entries 3 to 5 are no object there
    assert moved > 0.04  # metres, along every axis
    assert grip < 0.003


@pytest.mark.slow
def test_mjx_and_native_agree_with_an_object() -> None:
    grip, block, moved = largest_differences("pick_and_place")
    assert moved > 0.04
    assert grip < 0.003
    assert block < 0.001
