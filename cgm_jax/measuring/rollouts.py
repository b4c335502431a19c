"""Rollouts through the training loop's scan against raw MuJoCo."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from mujoco.batch import Batch

from cgm_jax import envs
from cgm_jax.envs.physics.native import SENSOR_STAGE
from cgm_jax.machine.allotment import available_cores
from cgm_jax.measuring.figures import Figure, medians


def measure_rollouts(repeats: int) -> list[Figure]:
    """Control steps through the scan against `Batch.step` of the very same motion."""
    figures = []
    for task in ("push", "pick_and_place"):
        for simulations in (16, 64, 512):
            scan, raw = rollout_seconds(task, simulations, repeats)
            steps = 50 * simulations
            figures += [
                Figure(
                    f"rollout, {task}, {simulations} environments: scan / raw Batch.step",
                    raw / scan,
                    "",
                    low=0.85 if simulations == 64 else None,
                ),
                Figure("  through the scan", steps / scan, "environment steps/s"),
            ]
    return figures


def rollout_seconds(task: str, simulations: int, repeats: int) -> tuple[float, float]:
    """Median seconds of an episode in each simulation: through the scan, and of raw MuJoCo."""
    env = envs.make(task, engine="native")
    actions = jax.random.uniform(jax.random.key(0), (50, simulations, 4), minval=-1.0, maxval=1.0)
    keys = jax.random.split(jax.random.key(1), simulations)
    first = jax.jit(jax.vmap(env.reset))(keys)

    def step(state: Any, action: jax.Array) -> tuple[Any, jax.Array]:
        state = jax.vmap(env.step)(state, action)
        return state, state.pipeline_state.engine_state

    scan = jax.jit(lambda state: jax.lax.scan(step, state, actions)[1])
    rows = np.asarray(scan(first)).view(np.float64)

    # A state row holds the commands that led to it: replaying them is the same work.
    batch = Batch(env.scene.model, simulations, available_cores())
    batch.bind("sensordata")
    batch.state[:] = rows[0]
    offsets = [batch.bind(name) for name in ("mocap_pos", "mocap_quat", "ctrl")]
    commands = []
    for row in rows:
        batch.state[:] = row
        commands.append([field.copy() for field in offsets])
    start = np.asarray(first.pipeline_state.engine_state).view(np.float64)  # pyright: ignore
    blocked = list(env.scene.blocked_addresses)

    def raw() -> None:
        batch.state[:] = start
        for command in commands:
            batch.bind("qpos")[:, blocked] = 0.0
            for field, values in zip(offsets, command, strict=True):
                field[:] = values
            batch.step(nstep=env.scene.substeps, stage=SENSOR_STAGE)

    raw()
    if not np.array_equal(batch.state, rows[-1]):
        raise RuntimeError("the raw simulation did not repeat the scan's motion")
    through_scan, raw_seconds = medians(
        [lambda: jnp.asarray(scan(first)).block_until_ready(), raw], repeats
    )
    return through_scan, raw_seconds
