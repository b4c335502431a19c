"""Says so where JAX would hang: in a process that was forked after JAX had started.

A fork copies none of the threads that JAX's backend computes on, so that the first computation
in the child waits for ever. `gymnasium.vector.AsyncVectorEnv` forks by default on Linux.
"""

import os
import sys

HOW_TO_START = (
    "start processes afresh, by "
    'AsyncVectorEnv(..., context="spawn"), '
    'gymnasium.make_vec(..., vector_kwargs={"context": "spawn"}), '
    'SubprocVecEnv(..., start_method="spawn")'
)

_jax_runs = False
_forked_while_jax_ran = False


def check_not_forked() -> None:
    """Check that JAX can compute in this process.

    Raises:
        RuntimeError: the process was forked from one in which this module was loaded and JAX's
            backend had started.
    """
    if _forked_while_jax_ran:
        raise RuntimeError(f"JAX would hang in a process forked after it started; {HOW_TO_START}")


def _before_fork() -> None:
    global _jax_runs
    # JAX has no public name for this; the version is pinned.
    bridge = sys.modules.get("jax._src.xla_bridge")
    _jax_runs = bridge is not None and bridge.backends_are_initialized()


def _after_fork() -> None:
    global _forked_while_jax_ran
    _forked_while_jax_ran = _forked_while_jax_ran or _jax_runs


if hasattr(os, "register_at_fork"):  # where there is no fork there is nothing to say
    os.register_at_fork(before=_before_fork, after_in_child=_after_fork)
