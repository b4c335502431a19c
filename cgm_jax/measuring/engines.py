"""How fast an engine simulates on the device at hand, through the training loop's scan."""

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from cgm_jax import envs
from cgm_jax.envs.physics.choose import choose_engine
from cgm_jax.measuring.figures import medians, seconds

CPU_ENVIRONMENTS, GPU_ENVIRONMENTS = 64, 1024


class EngineRate(NamedTuple):
    """What an engine does.

    Attributes:
        compiling: seconds until its first resets and its first rollout are done.
        rate: environment steps per second after that.
        warnings: physics warnings in a rollout; contacts that found no room are among them.
    """

    compiling: float
    rate: float
    warnings: int


def engine_rate(engine: str, task: str, environments: int, repeats: int, steps: int) -> EngineRate:
    """Random actions in a Fetch task; each measurement is of `steps` steps of all environments.

    Raises:
        ValueError: the engine is not installed, or cannot run on JAX's device.
    """
    env = envs.make(task, engine=engine)
    shape = (steps, environments, env.action_size)
    actions = jax.random.uniform(jax.random.key(0), shape, minval=-1.0, maxval=1.0)
    keys = jax.random.split(jax.random.key(1), environments)

    def step(state: Any, action: jax.Array) -> tuple[Any, jax.Array]:
        state = jax.vmap(env.step)(state, action)
        return state, state.metrics["physics_warnings"].sum()

    jit = partial(jax.jit, compiler_options=dict(env.physics.compiler_options))
    reset = jit(jax.vmap(env.reset))
    rollout = jit(lambda state: jax.lax.scan(step, state, actions)[1].sum())
    compiling = seconds(lambda: rollout(reset(keys)).block_until_ready())
    first = reset(keys)
    (taken,) = medians([lambda: rollout(first).block_until_ready()], repeats)
    return EngineRate(compiling, steps * environments / taken, int(jnp.asarray(rollout(first))))


def device_line(repeats: int) -> str:
    """The device, the engine that is the default there, and how fast it simulates."""
    engine, device = choose_engine("auto"), jax.devices()[0]
    environments = CPU_ENVIRONMENTS if device.platform == "cpu" else GPU_ENVIRONMENTS
    found = engine_rate(engine, "push", environments, repeats, steps=50)
    return (
        f"device: {len(jax.devices())} x {device.device_kind}; engine: {engine}; "
        f"{environments} environments of push: {found.rate:,.0f} environment steps/s, "
        f"{found.warnings} physics warnings, first rollout after {found.compiling:.1f} s"
    )
