"""States of an environment of the user's own, in the form that a scan over an episode needs."""

from collections.abc import Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

ENTRIES = ("observation", "achieved_goal", "desired_goal")
OUTPUTS = ("reward", "done", "metrics")
KEPT = ("info", "obs")
WARNINGS = "physics_warnings"


def warnings_of(state: Any) -> jax.Array:
    """1 if a state tells of broken physics, else 0; NaN tells of it, too."""
    metrics = getattr(state, "metrics", None)  # of any type
    reported = metrics.get(WARNINGS, 0.0) if isinstance(metrics, Mapping) else 0.0
    return jnp.any(~(jnp.asarray(reported) <= 0)).astype(jnp.float32)


def as_before(before: Any, after: Any) -> Any:
    """A state with the structure and types of the one before."""
    return jax.tree.map(retyped, with_unread_of(before, after), before)


def with_unread_of(before: Any, after: Any) -> Any:
    """`after`, with what nothing reads in the structure and the types that it has in `before`.

    What an environment keeps for itself stays as it is where its type would lose something of it.
    """
    fields = {
        name: _fitted(getattr(before, name), getattr(after, name), is_output=name in OUTPUTS)
        for name in (*OUTPUTS, "info")
        if hasattr(before, name) and hasattr(after, name)
    }
    others = {name: value for name, value in before.obs.items() if name not in ENTRIES}
    read = {entry: after.obs[entry] for entry in ENTRIES}
    kept = _fitted(others, after.obs, is_output=False)
    return after.replace(obs={**kept, **read}, **fields)


def _fitted(before: Any, after: Any, *, is_output: bool) -> Any:
    """`after` retyped, less new entries; an entry that is gone, or an unfit output, as before."""
    if isinstance(before, dict) and isinstance(after, dict):
        return {
            name: _fitted(value, after[name], is_output=is_output) if name in after else value
            for name, value in before.items()
        }
    fits = jax.tree.structure(before) == jax.tree.structure(after) and all(
        np.shape(old) == np.shape(new) and _takes(old, new, is_output=is_output)
        for old, new in zip(jax.tree.leaves(before), jax.tree.leaves(after), strict=True)
    )
    if fits:
        return jax.tree.map(retyped, after, before)
    return before if is_output else after


def _takes(old: Any, new: Any, *, is_output: bool) -> bool:
    """Whether a leaf may become one of another's type: of what is kept, without any loss."""
    if is_key(old, new):
        return dtype_of(old) == dtype_of(new)
    return is_output or holds(old, new)


def holds(old: Any, new: Any) -> bool:
    """Whether numbers of the type of `old` can be those of the type of `new`, as float32 int32's.

    What of large whole numbers a floating-point one rounds does not count.
    """
    return jnp.promote_types(dtype_of(old), dtype_of(new)) == dtype_of(old)


def unread_additions(before: Any, after: Any) -> list[str]:
    """Entries of what an environment keeps for itself that only `after` has, as Python writes them.

    No scan over an episode can take them along.
    """
    kept = [(name, getattr(before, name, None), getattr(after, name, None)) for name in KEPT]
    return [
        f"{name}[{entry!r}]"
        for name, old, new in kept
        if isinstance(old, Mapping) and isinstance(new, Mapping)
        for entry in new
        if entry not in old
    ]


def retyped(leaf: Any, like: Any) -> Any:
    """A leaf as the type of another, and without the weak type of Python's numbers."""
    if isinstance(leaf, jax.ShapeDtypeStruct):
        return jax.ShapeDtypeStruct(leaf.shape, like.dtype)
    return leaf if is_key(leaf) else jax.lax.convert_element_type(leaf, dtype_of(like))


def dtype_of(leaf: Any) -> Any:
    """The type of an array, of its shape, or of a number of Python's."""
    return leaf.dtype if hasattr(leaf, "dtype") else jnp.result_type(leaf)


def is_key(*leaves: Any) -> bool:
    """Whether any of the leaves is a key of `jax.random`."""
    return any(jnp.issubdtype(dtype_of(leaf), jax.dtypes.prng_key) for leaf in leaves)


def convertible(leaf: Any, like: Any) -> bool:
    """Whether a leaf can become one like another: as large, and a number of the same kind."""
    if leaf.shape != like.shape:
        return False
    if leaf.dtype == like.dtype:
        return True
    return any(
        jnp.issubdtype(leaf.dtype, kind) and jnp.issubdtype(like.dtype, kind)
        for kind in (jnp.floating, jnp.integer)
    )


def path_text(path: Any) -> str:
    """Where a leaf lies, as Python would write it."""
    return jax.tree_util.keystr(path).lstrip(".")


def described(leaf: Any) -> str:
    """Type and shape of a leaf, for a message."""
    if leaf is None:
        return "absent"
    return f"{leaf.dtype}[{','.join(map(str, leaf.shape))}]"


def in_one_line(value: Any) -> str:
    """A value of the user's, short and in one line."""
    text = " ".join(repr(value).split())
    return text if len(text) <= 60 else f"{text[:57]}..."
