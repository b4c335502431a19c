"""The axis of runs, spread over the devices of this process.

Runs are independent, so each device takes its share of them and never waits for another. If their
number is no multiple of that of the devices, the axis is padded with copies of the last run. Nobody
trains or reads these.

A GPU trains its runs side by side, under `jax.vmap`. A CPU trains them one after another, so that
their bits are the same on however many devices (in_turn.py).
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
        runs: of each of them, padding included.
    """

    devices: int
    runs: int


def share(runs: int, devices: int) -> Share:
    """Divide runs: first with the largest share as small as possible, then on as few devices."""
    each = -(-runs // max(1, min(runs, devices)))
    return Share(-(-runs // each), each)


class Team(NamedTuple):
    """Devices that share the axis of runs.

    Attributes:
        mesh: all of them, in one axis, `RUNS`.
        size: how many of them, the first ones, are given runs.
    """

    mesh: Mesh
    size: int

    def each(self, runs: int) -> int:
        """Rows of each device for so many runs."""
        return -(-runs // self.size)


def team_of(devices: Sequence[Device]) -> Team:
    """Devices that share the axis of runs.

    A CPU's one device gets an idle one beside it, if there is another. XLA simplifies programs of
    one device in another order than those of several, so that bits would differ.
    """
    meshed = list(devices)
    if len(meshed) == 1 and meshed[0].platform == "cpu":
        meshed += [other for other in jax.devices("cpu") if other != meshed[0]][:1]
    return Team(Mesh(np.array(meshed), (RUNS,)), len(devices))


def spread(team: Team, tree: Tree) -> Tree:
    """What has a leading axis of runs, padded and on the team's devices."""
    return jax.tree.map(lambda leaf: _spread(team, leaf), tree)


def _spread(team: Team, leaf: Any) -> jax.Array:
    leaf = leaf if isinstance(leaf, jax.Array) else jnp.asarray(leaf)
    rows = team.each(len(leaf)) * team.mesh.size
    return jax.device_put(_padded(leaf, rows), NamedSharding(team.mesh, SPREAD))


def _padded(leaf: jax.Array, rows: int) -> jax.Array:
    """So many rows, those beyond the last one as that is."""
    missing = rows - len(leaf)
    return jnp.concatenate([leaf, jnp.repeat(leaf[-1:], missing, axis=0)]) if missing else leaf


def spread_shapes(team: Team, tree: Tree) -> Tree:
    """Shapes whose leading axis is that of runs, padded, with where `spread` puts them."""
    sharding = NamedSharding(team.mesh, SPREAD)
    return jax.tree.map(lambda leaf: leaf.update(sharding=sharding), tree)


def on_each(team: Team, function: Callable[..., Any], *specs: PartitionSpec) -> Callable[..., Any]:
    """Have each device of a team call a function.

    Args:
        team: whose devices.
        function: to arrays whose leading axis is the device's rows.
        specs: of each argument, `SPREAD` (the device's rows) or `ON_EACH` (all of it).
    """
    # No run depends on another one, so there is nothing to check that a device does with others.
    return jax.shard_map(
        function, mesh=team.mesh, in_specs=specs, out_specs=SPREAD, check_vma=False
    )


def own_rows(team: Team, tree: Tree) -> tuple[Tree, jax.Array]:
    """Inside `on_each`: a device's rows of what has a leading axis of all runs.

    Returns:
        The rows, padding included; and how many are not padding.
    """
    runs = len(jax.tree.leaves(tree)[0])
    each = team.each(runs)
    first = jax.lax.axis_index(RUNS) * each
    rows = jax.tree.map(
        lambda leaf: jax.lax.dynamic_slice_in_dim(
            _padded(leaf, each * team.size), first, each, allow_negative_indices=False
        ),
        tree,
    )
    return rows, jnp.clip(runs - first, 0, each)
