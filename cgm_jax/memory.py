"""How much memory a group of runs will take, and how many runs fit."""

import os
from pathlib import Path

import jax

from cgm_jax.settings import Hyperparameters
from cgm_jax.training import Trainer

USABLE_SHARE = 0.8
"""Share of the free memory that a sweep may plan with."""


def bytes_per_run(trainer: Trainer) -> int:
    """Memory that one run takes on the device: its state, and the largest part of a cycle.

    That part is all transitions of a cycle's updates, before and after normalisation.
    """
    state = jax.eval_shape(trainer.initial_state, Hyperparameters())
    key = jax.eval_shape(jax.random.key, 0)
    minibatches = jax.eval_shape(trainer.minibatches, state, Hyperparameters(), key)
    return tree_bytes(state) + 2 * tree_bytes(minibatches)


def tree_bytes(tree: object) -> int:
    """Bytes of all arrays in a pytree of arrays or shapes."""
    return sum(leaf.size * leaf.dtype.itemsize for leaf in jax.tree.leaves(tree))


def free_bytes() -> int:
    """Free memory of the device that JAX computes on; of the host if that is the CPU."""
    statistics = jax.devices()[0].memory_stats()
    if statistics and "bytes_limit" in statistics:
        return statistics["bytes_limit"] - statistics.get("bytes_in_use", 0)
    return min(_free_on_host(), _left_in_container())


def runs_that_fit(per_run: int) -> int:
    """Runs of that size that fit at once; at least one is always tried."""
    return max(1, int(free_bytes() * USABLE_SHARE) // per_run)


def _free_on_host() -> int:
    meminfo = Path("/proc/meminfo")
    if meminfo.is_file():
        for line in meminfo.read_text().splitlines():
            if line.startswith("MemAvailable:"):
                return int(line.split()[1]) * 1024
    return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")


def _left_in_container() -> int:
    """What the control group still allows, where there is one with a limit."""
    folder = Path("/sys/fs/cgroup")
    try:
        limit, used = (int((folder / f"memory.{part}").read_text()) for part in ("max", "current"))
        entries = dict(line.split() for line in (folder / "memory.stat").read_text().splitlines())
    except (OSError, ValueError):
        return 2**63
    return limit - used + int(entries.get("inactive_file", 0))  # file cache makes way
