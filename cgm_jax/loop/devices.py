"""The axis of runs, spread over the devices of this process.

Runs are independent, so each device takes its share of them and never waits for another. Where
they do not divide, the last run is repeated to fill the axis up; nobody reads these rows.
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec

RUNS = "runs"
"""The mesh's one axis."""

SPREAD, ON_EACH = PartitionSpec(RUNS), PartitionSpec()

Tree = TypeVar("Tree")
Device = Any
"""A `jax.Device`, which type checkers take for no type."""


class Share(NamedTuple):
    """How runs are shared out.

    Attributes:
        devices: how many take part.
        runs: of each of them, repeated ones included.
    """

    devices: int
    runs: int


def share(runs: int, devices: int) -> Share:
    """Share runs out, the largest share as small as can be, then on as few devices as can be."""
    each = -(-runs // max(1, min(runs, devices)))
    return Share(-(-runs // each), each)


def mesh_of(devices: Sequence[Device]) -> Mesh:
    """A mesh of one axis, `RUNS`."""
    return Mesh(np.array(devices), (RUNS,))


def spread(mesh: Mesh, tree: Tree) -> Tree:
    """A pytree whose leaves have a leading axis of runs, filled up and on the mesh's devices."""
    return jax.tree.map(lambda leaf: _spread(mesh, leaf), tree)


def _spread(mesh: Mesh, leaf: Any) -> jax.Array:
    leaf = leaf if isinstance(leaf, jax.Array) else jnp.asarray(leaf)
    missing = -len(leaf) % mesh.size
    if missing:
        leaf = jnp.concatenate([leaf, jnp.repeat(leaf[-1:], missing, axis=0)])
    return jax.device_put(leaf, NamedSharding(mesh, SPREAD))


def on_mesh(mesh: Mesh, function: Callable[..., Any], *specs: PartitionSpec) -> Callable[..., Any]:
    """Have each device call a function on its share of the runs.

    Args:
        mesh: whose devices.
        function: from arrays with a leading axis of runs to such arrays.
        specs: of each argument, `SPREAD` or `ON_EACH`.
    """
    # No run depends on another one, so there is nothing to check that a device does with others.
    return jax.shard_map(function, mesh=mesh, in_specs=specs, out_specs=SPREAD, check_vma=False)
