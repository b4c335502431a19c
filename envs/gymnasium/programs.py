"""The compiled functions behind the environments."""

import functools
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from brax.envs.base import State

from cgm_jax.envs.fetch import FetchEnvironment
from cgm_jax.envs.gymnasium.arguments import check_fields
from cgm_jax.envs.names import make_deferred
from cgm_jax.envs.physics.choose import check_engine
from cgm_jax.envs.physics.deferred import DeferredPhysics
from cgm_jax.machine.forking import check_not_forked


@dataclass(frozen=True)
class FetchPrograms:
    """One Fetch environment with its compiled functions.

    A copy, by `copy.deepcopy` or `pickle`, is what `fetch_programs` gives for the same arguments
    in the process that copies, so that environments can be copied and sent elsewhere.

    Attributes:
        arguments: of `fetch_programs`.
        env: the environment.
        reset: from a seed, a uint32 scalar, to a state.
        step: from a state and an action [4] to the next state.
        reset_many: the same for seeds [n].
        step_many: the same for n states and actions [n, 4].
        select: from a condition [n] and two batches of states to one, row by row.
    """

    arguments: tuple[Any, ...]
    env: FetchEnvironment
    reset: Callable[[np.uint32], State]
    step: Callable[[State, np.ndarray], State]
    reset_many: Callable[[np.ndarray], State]
    step_many: Callable[[State, np.ndarray], State]
    select: Callable[[np.ndarray, State, State], State]

    def started(self) -> "FetchPrograms":
        """These programs, ready to be called.

        Raises:
            RuntimeError: JAX would hang in this process.
            ValueError: the engine cannot run on JAX's device.
        """
        check_not_forked()
        if isinstance(self.env.physics, DeferredPhysics):
            self.env.physics.begin()
        return self

    def __reduce__(self) -> tuple[Any, ...]:
        return _programs, self.arguments


def fetch_programs(task: str, engine: str, **fields: float) -> FetchPrograms:
    """An environment and its programs, made once per process and set of arguments.

    Nothing of JAX runs yet. Each program compiles at its first call, for all instances together.

    Raises:
        TypeError: a field is no number.
        ValueError: as `envs.make`.
    """
    check_engine(engine)
    check_fields(fields)
    return _programs(task, engine, tuple(sorted(fields.items())))


@functools.cache
def _programs(task: str, engine: str, fields: tuple[tuple[str, float], ...]) -> FetchPrograms:
    env = make_deferred(task, engine, **dict(fields))

    def reset(seed: jax.Array) -> State:
        return env.reset(jax.random.key(seed))

    def select(condition: jax.Array, yes: State, no: State) -> State:
        choose = jax.vmap(lambda chosen, x, y: jnp.where(chosen, x, y))
        return jax.tree.map(lambda x, y: choose(condition, x, y), yes, no)

    jit = functools.partial(jax.jit, compiler_options=dict(env.physics.compiler_options))
    return FetchPrograms(
        arguments=(task, engine, fields),
        env=env,
        reset=jit(reset),
        step=jit(env.step),
        reset_many=jit(jax.vmap(reset)),
        step_many=jit(jax.vmap(env.step)),
        select=jax.jit(select),
    )


def draw_seed(generator: np.random.Generator) -> np.uint32:
    """A seed for `FetchPrograms.reset`, a uint32 scalar."""
    return generator.integers(2**32, dtype=np.uint32)
