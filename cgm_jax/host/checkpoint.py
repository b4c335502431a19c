"""How far a group of runs has trained, in files that are written whole and checked when read.

    group0_epoch000003_cycle000012.npz    the whole training state, and the rows of metrics.jsonl
    group0_epoch000003_cycle000012.json   its format, SHA-256, size, and config.json; written last

In the middle of a cycle that is cut, `_part000007` is added to the names: seven parts are done.
Only such a file holds what is unfinished, so that any device can go on from the others.

A checkpoint without its manifest was never finished. One that does not match it is damaged: it
is set aside under a name that says so, and the one before serves. One that cannot be read just now,
as on a network disk that is away, is not damaged: it stays, and the command fails.
"""

import contextlib
import hashlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, BinaryIO

import jax
import jax.numpy as jnp
import numpy as np

from cgm_jax.config.fields import SettingError
from cgm_jax.loop.state import TrainingState
from cgm_jax.storage.arrays import open_arrays, read_shapes, write_arrays
from cgm_jax.storage.checkpoints import (
    FORMAT,
    damage,
    finished_checkpoints,
    format_of,
    last_whole,
    manifest_path,
    write_manifest,
)
from cgm_jax.storage.files import PARTIAL, reading, replacing
from cgm_jax.storage.metrics import Row, from_lines, to_lines
from cgm_jax.storage.untrusted import UNREADABLE

KEPT = 2
DAMAGED = ".damaged"
UNFINISHED = ".unfinished."
"""Leaves of a cycle that is cut, which mean nothing before its first part."""

RING = ".replay.episodes."
"""Leaves of the replay ring [runs, slots, ...], of which only the filled slots are stored."""


@dataclass
class TrainingProgress:
    """How far a group of runs has trained, and what it needs to resume there.

    Attributes:
        state: training state, every leaf [runs or more, ...]: devices that share the axis may have
            filled it up.
        epoch: whole epochs done.
        cycle: cycles done of the next epoch.
        wall_s: seconds of training so far, over all processes that took part.
        rows: its rows of metrics.jsonl so far.
        runs: how many of the state's there are in truth, and are stored; None for all.
        part: parts done of the next cycle, where cycles are cut.
    """

    state: TrainingState
    epoch: int = 0
    cycle: int = 0
    wall_s: float = 0.0
    rows: list[Row] = field(default_factory=list)
    runs: int | None = None
    part: int = 0


def save_checkpoint(
    directory: Path, group: int, training: TrainingProgress, config: bytes = b""
) -> Path:
    """Write a checkpoint and keep the group's last two.

    Args:
        directory: where checkpoints lie.
        group: number of the group.
        training: how far it has trained.
        config: the bytes of config.json, which can be restored from a checkpoint.

    Raises:
        OSError: it cannot be written; the ones before are still there.
    """
    name = f"group{group}_epoch{training.epoch:06d}_cycle{training.cycle:06d}"
    name += f"_part{training.part:06d}" if training.part else ""
    path = directory / f"{name}.npz"
    manifest_path(path).unlink(missing_ok=True)
    with replacing(path, durable=True) as file:
        hashing = _HashingWriter(file)
        write_arrays(hashing, _named_arrays(training))  # pyright: ignore[reportArgumentType]
    write_manifest(path, hashing.digest.hexdigest(), hashing.written, config)
    _remove_old(directory, group)
    return path


def load_checkpoint(
    directory: Path, group: int, like: TrainingState
) -> tuple[TrainingProgress | None, list[str]]:
    """The group's latest checkpoint that is whole.

    Args:
        directory: where checkpoints lie.
        group: number of the group.
        like: a state of the same structure, whose leaves may be mere shapes.

    Returns:
        How far the group has trained, None if there is no whole checkpoint; and a line about each
        damaged one, which has been set aside.

    Raises:
        SettingError: the file is of a newer format; or it is whole, but holds the state of another
            program.
        ReadError: it cannot be read just now.
    """
    notes = []
    whole, damaged = last_whole(directory, group)
    for path, complaint in damaged.items():
        for part in (path, manifest_path(path)):
            with contextlib.suppress(OSError):
                part.replace(part.with_name(part.name + DAMAGED))
        notes.append(f"{path} is damaged ({complaint}) and set aside")
    return None if whole is None else _read(whole, like), notes


def check_last_checkpoint(directory: Path, group: int, like: TrainingState) -> None:
    """Check what can be checked of a group's last checkpoint without reading its arrays.

    What may be damage is left to `load_checkpoint`, which takes the one before.

    Raises:
        SettingError, ReadError: as `load_checkpoint`.
    """
    for path in finished_checkpoints(directory, group)[-1:]:
        format_of(path)
        try:
            _check_shapes(path, like)
        except SettingError:
            if damage(path) is None:
                raise


def _remove_old(directory: Path, group: int) -> None:
    """Remove all but the last checkpoints, and what a killed process left half written."""
    kept = finished_checkpoints(directory, group)[-KEPT:]
    keep = {*kept, *(manifest_path(path) for path in kept)}
    for path in directory.glob(f"group{group}_epoch*"):
        if path not in keep and path.suffix in (".npz", ".json", PARTIAL):
            path.unlink(missing_ok=True)


class _HashingWriter:
    """Passes bytes on to a file and hashes them. Cannot seek, so that it sees each byte once."""

    def __init__(self, file: BinaryIO) -> None:
        self._file = file
        self.digest = hashlib.sha256()
        self.written = 0

    def write(self, data: Any) -> int:
        self.digest.update(data)
        self.written += memoryview(data).nbytes
        return self._file.write(data)

    def flush(self) -> None:
        self._file.flush()


def _named_arrays(
    training: TrainingProgress,
) -> Iterator[tuple[str, np.ndarray | list[np.ndarray]]]:
    """What a checkpoint holds, one array at a time."""
    yield "position", np.array([training.epoch, training.cycle], np.int64)
    yield "wall_s", np.array(training.wall_s)
    yield "rows", np.frombuffer(to_lines(training.rows).encode(), np.uint8)
    filled = _filled(training.state)
    for name, leaf in named_leaves(training.state):
        if name.startswith(UNFINISHED) and not training.part:
            continue
        rows = _rows_of(jax.random.key_data(leaf) if _is_key(leaf) else leaf)[: training.runs]
        yield name, [row[:filled] for row in rows] if name.startswith(RING) else rows


def _rows_of(leaf: jax.Array | np.ndarray) -> list[np.ndarray]:
    """Rows of an array that lies on several devices, where they lie, or on the host.

    `numpy.asarray` would first put them together, which takes as much memory again.
    """
    if isinstance(leaf, np.ndarray):
        return list(leaf)
    shards = {shard.index[0].start or 0: shard.data for shard in leaf.addressable_shards}
    return [row for start in sorted(shards) for row in np.asarray(shards[start])]


def _filled(state: TrainingState) -> int:
    """Slots of the replay ring that any run has filled; the others hold zeros."""
    slots = state.replay.episodes.mask.shape[1]
    return min(slots, int(np.max(np.asarray(state.replay.inserted))))


def _read(path: Path, like: TrainingState) -> TrainingProgress:
    """Read a checkpoint whose checksum is right, which does not mean that it is ours."""
    _check_shapes(path, like)
    try:
        with reading(path), open_arrays(path) as arrays:
            state = _restored(arrays, like)
            epoch, cycle = (int(number) for number in arrays["position"])
            rows, wall_s = _rows(path, bytes(arrays["rows"])), float(arrays["wall_s"])
    except SettingError:
        raise
    except ValueError as error:
        raise SettingError(f"resume: {error}") from None
    if min(epoch, cycle) < 0:
        raise _foreign(path)
    runs = len(jax.tree.leaves(like)[0])
    part = 0 if state.unfinished is None else int(state.unfinished.done[0])
    return TrainingProgress(state, epoch, cycle, wall_s, rows, runs, part)


def _restored(arrays: Mapping[str, np.ndarray], like: TrainingState) -> TrainingState:
    """A training state from what is stored of it."""
    leaves = [
        restore_leaf(arrays[name], leaf)
        if name in arrays
        else jnp.zeros(leaf.shape, leaf.dtype)  # nothing is unfinished
        for name, leaf in named_leaves(like)
    ]
    return jax.tree.unflatten(jax.tree.structure(like), leaves)


def _check_shapes(path: Path, like: TrainingState) -> None:
    """Check that a checkpoint has the arrays of such a state.

    Raises:
        SettingError: it has not.
    """
    try:
        stored = read_shapes(path)
    except ValueError as error:
        raise SettingError(f"resume: {error}") from None
    expected = {name: stored_like(leaf) for name, leaf in named_leaves(like)}
    within = any(name.startswith(UNFINISHED) for name in stored)
    if within and not any(name.startswith(UNFINISHED) for name in expected):
        raise SettingError(
            f"resume: {path} was stopped in the middle of a cycle that was cut, as on a CPU long "
            "ones are; here they are whole"
        )
    if not within:
        expected = {name: x for name, x in expected.items() if not name.startswith(UNFINISHED)}
    others = {"position": ((2,), np.int64), "wall_s": ((), np.float64), "rows": (None, np.uint8)}
    if set(stored) != {*expected, *others}:
        raise _foreign(path)
    for name, (shape, dtype) in {**expected, **others}.items():
        actual, kind = stored[name]
        if name.startswith(RING):  # any number of slots up to the ring's
            fits = len(actual) == len(shape) and actual[1] <= shape[1]
            fits = fits and (actual[0], *actual[2:]) == (shape[0], *shape[2:])
        else:
            fits = shape is None or actual == shape
        if not fits or kind != dtype:
            raise _foreign(path)


def _rows(path: Path, text: bytes) -> list[Row]:
    try:
        return from_lines(text.decode().splitlines())
    except UNREADABLE:
        raise _foreign(path) from None


def _foreign(path: Path) -> SettingError:
    number = format_of(path)
    age = f"is a checkpoint of format {number}, of an older version of cgm_jax, and "
    return SettingError(
        f"resume: {path} {age if number < FORMAT else ''}holds the state of another program"
    )


def named_leaves(state: TrainingState) -> list[tuple[str, jax.Array]]:
    """Leaves of a training state, by the names that they have in checkpoints."""
    leaves, _ = jax.tree_util.tree_flatten_with_path(state)
    return [(jax.tree_util.keystr(path), leaf) for path, leaf in leaves]


def stored_like(leaf: jax.Array) -> tuple[tuple[int, ...], Any]:
    """Shape and type that a leaf has in a file; PRNG keys are stored as their words."""
    stored = jax.eval_shape(jax.random.key_data, leaf) if _is_key(leaf) else leaf
    return stored.shape, stored.dtype


def restore_leaf(array: np.ndarray, like: jax.Array) -> jax.Array:
    """A leaf from what is stored of it."""
    if _is_key(like):
        return jax.random.wrap_key_data(jnp.asarray(array))
    if array.shape != like.shape:  # the ring, without its empty slots
        whole = np.zeros(like.shape, like.dtype)
        whole[:, : array.shape[1]] = array
        array = whole
    return jnp.array(array)  # a copy, which the programs may take over


def _is_key(leaf: jax.Array) -> bool:
    return jnp.issubdtype(leaf.dtype, jax.dtypes.prng_key)
