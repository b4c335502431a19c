"""The whole training state of a group of runs, as one file of plain arrays."""

from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from cgm_jax.training_state import TrainingState

KEPT = 2


def save_checkpoint(directory: Path, group: int, epoch: int, state: TrainingState) -> Path:
    """Write the state atomically and keep the group's last two checkpoints."""
    path = directory / f"group{group}_epoch{epoch:06d}.npz"
    partial = path.with_suffix(".partial")
    with partial.open("wb") as file:
        np.savez(file, **_named_arrays(state))  # pyright: ignore[reportArgumentType]
    partial.replace(path)
    for old in sorted(directory.glob(f"group{group}_epoch*.npz"))[:-KEPT]:
        old.unlink()
    return path


def load_checkpoint(path: Path, like: TrainingState) -> TrainingState:
    """Read a state of the same structure as `like`, whose leaves may be mere shapes.

    Raises:
        ValueError: the file holds another structure.
    """
    leaves, structure = jax.tree_util.tree_flatten_with_path(like)
    with np.load(path, allow_pickle=False) as file:
        if set(file.files) != {jax.tree_util.keystr(name) for name, _ in leaves}:
            raise ValueError(f"{path}: holds the state of another program")
        arrays = [_restore(file[jax.tree_util.keystr(name)], leaf) for name, leaf in leaves]
    return jax.tree.unflatten(structure, arrays)


def _named_arrays(state: TrainingState) -> dict[str, np.ndarray]:
    leaves, _ = jax.tree_util.tree_flatten_with_path(state)
    return {
        jax.tree_util.keystr(name): np.asarray(jax.random.key_data(leaf) if _is_key(leaf) else leaf)
        for name, leaf in leaves
    }


def _restore(array: np.ndarray, like: jax.Array) -> jax.Array:
    if _is_key(like):
        return jax.random.wrap_key_data(jnp.asarray(array))
    return jnp.asarray(array, like.dtype)


def _is_key(leaf: jax.Array) -> bool:
    return jnp.issubdtype(leaf.dtype, jax.dtypes.prng_key)
