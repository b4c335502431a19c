"""Runs of one device, one after another: what a CPU does in place of `jax.vmap`.

The program of a run is then the same, instruction by instruction, whichever runs are beside it and
however many there are, and so are its bits. Under vmap XLA fuses and vectorises differently for
every number of runs. It costs a call of the physics per run instead of one for all, which small
networks feel.
"""

from collections.abc import Callable
from typing import Any, TypeVar

import jax

Tree = TypeVar("Tree")


def in_turn(function: Callable[..., Any], count: jax.Array) -> Callable[..., Any]:
    """Like `jax.vmap` of a function, for one row after another.

    Args:
        function: of pytrees of arrays, to a pytree of arrays.
        count: of how many rows, the first ones; what comes of the others is undefined. XLA must
            not know it, or it would unroll a loop of one row.
    """

    def on_rows(*trees: Any) -> Any:
        rows = len(jax.tree.leaves(trees)[0])
        like = jax.eval_shape(lambda *trees: function(*_row(trees, 0)), *trees)
        empty = jax.tree.map(lambda leaf: jax.lax.empty((rows, *leaf.shape), leaf.dtype), like)

        def turn(index: jax.Array, done: Any) -> Any:
            return _with_row(done, index, _apart(index, function, *_row(trees, index)))

        return jax.lax.fori_loop(0, count, turn, empty)

    return on_rows


def in_place(function: Callable[..., Any], count: jax.Array) -> Callable[..., Any]:
    """Like `in_turn` of a function from a state to the next one, in the buffers of the states.

    Args:
        function: of a state and a further pytree of arrays, to a state.
        count: of how many rows, the first ones; the others stay as they are.
    """

    def on_rows(states: Tree, tree: Any) -> Tree:
        def turn(index: jax.Array, states: Tree) -> Tree:
            after = _apart(index, function, _row(states, index), _row(tree, index))
            return _with_row(states, index, after)

        return jax.lax.fori_loop(0, count, turn, states)

    return on_rows


def _apart(index: jax.Array, function: Callable[..., Any], *arguments: Any) -> Any:
    """Call a function that XLA neither fuses with what is around it nor moves out of the loop.

    With a single row nothing but the barrier depends on the turn. Moved out of the loop, the
    function would be computed also on a device that has no runs.
    """
    barrier = jax.lax.optimization_barrier
    arguments, _ = barrier((arguments, index))
    return barrier(function(*arguments))


def _row(tree: Tree, index: jax.Array | int) -> Tree:
    return jax.tree.map(
        lambda leaf: jax.lax.dynamic_index_in_dim(
            leaf, index, keepdims=False, allow_negative_indices=False
        ),
        tree,
    )


def _with_row(tree: Tree, index: jax.Array, row: Tree) -> Tree:
    return jax.tree.map(
        lambda leaf, new: jax.lax.dynamic_update_index_in_dim(
            leaf, new, index, 0, allow_negative_indices=False
        ),
        tree,
        row,
    )
