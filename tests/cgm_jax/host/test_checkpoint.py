import dataclasses
import errno
import hashlib
import json
import os
import zipfile
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from cgm_jax.config.fields import SettingError, stack
from cgm_jax.host import checkpoint
from cgm_jax.host.checkpoint import (
    TrainingProgress,
    check_last_checkpoint,
    load_checkpoint,
    save_checkpoint,
)
from cgm_jax.loop.state import TrainingState
from cgm_jax.loop.training import make_programs, make_trainer
from cgm_jax.replay.ring import Replay
from cgm_jax.storage import checkpoints
from cgm_jax.storage.checkpoints import (
    FORMAT,
    epochs_begun,
    finished_checkpoints,
    last_whole,
    position_of,
)
from cgm_jax.storage.files import ReadError
from tests.cgm_jax.archives import spoil
from tests.cgm_jax.probe import TINY, tiny
from tests.cgm_jax.protocols import assert_same
from tests.cgm_jax.refusing import refusing
from tests.examples.point_mass import PointMass

# A ring of 80 slots, of which one cycle fills 8.
PROGRAMS = make_programs(
    make_trainer(PointMass(), dataclasses.replace(TINY, replay_transitions=2000))
)
HYPER = stack([tiny(seed=0), tiny(seed=1)])
LIKE = jax.eval_shape(PROGRAMS.start, HYPER)
ROWS = [{"run": "a", "success_rate": None}, {"run": "ä", "mask_share": [0.1, 0.5]}]


@pytest.fixture(scope="module")
def state() -> TrainingState:
    """A state as after a cycle: no number is where it started, but in slots that are empty yet."""
    draw = np.random.default_rng(0)

    def changed(leaf: jax.Array) -> jax.Array:
        if leaf.dtype == bool or jnp.issubdtype(leaf.dtype, jax.dtypes.prng_key):
            return leaf
        other = np.asarray(leaf) + draw.uniform(1, 9, leaf.shape)
        return jnp.asarray(other.astype(leaf.dtype))

    def filled(slots: jax.Array) -> jax.Array:
        array = np.array(slots)
        array[:, 8:] = 0
        return jnp.asarray(array)

    state = jax.tree.map(changed, PROGRAMS.start(HYPER))
    inserted = jnp.asarray(np.full(2, 8, np.int32))
    return state.replace(replay=Replay(jax.tree.map(filled, state.replay.episodes), inserted))


def save(directory: Path, state: TrainingState, epoch: int, cycle: int = 0, group: int = 0) -> Path:
    return save_checkpoint(directory, group, TrainingProgress(state, epoch, cycle, 12.5, ROWS))


def load(directory: Path) -> tuple[TrainingProgress, list[str]]:
    training, notes = load_checkpoint(directory, 0, LIKE)
    assert training is not None
    return training, notes


def test_a_checkpoint_holds_every_bit(tmp_path: Path, state: TrainingState) -> None:
    save(tmp_path, state, epoch=3, cycle=1)
    training, notes = load(tmp_path)
    assert (training.epoch, training.cycle, training.wall_s) == (3, 1, 12.5)
    assert training.rows == ROWS
    assert notes == []
    assert jax.tree.structure(training.state) == jax.tree.structure(state)
    restored = PROGRAMS.spread(training.state)
    begun = PROGRAMS.start(HYPER)
    for leaf, other in zip(jax.tree.leaves(restored), jax.tree.leaves(begun), strict=True):
        assert leaf.dtype == other.dtype
        assert leaf.aval == other.aval  # weak types would compile anew
    assert_same(restored, state)


def test_only_the_filled_part_of_the_replay_ring_is_stored(
    tmp_path: Path, state: TrainingState
) -> None:
    with np.load(save(tmp_path, state, epoch=1)) as file:
        assert file[".replay.episodes.mask"].shape == (2, 8, 2)


def test_rows_are_stored_as_the_lines_of_metrics_jsonl(
    tmp_path: Path, state: TrainingState
) -> None:
    with np.load(save(tmp_path, state, epoch=1)) as file:
        assert bytes(file["rows"]).decode() == (
            '{"run": "a", "success_rate": null}\n{"run": "\\u00e4", "mask_share": [0.1, 0.5]}\n'
        )


def test_the_last_two_checkpoints_of_a_group_are_kept(tmp_path: Path, state: TrainingState) -> None:
    for rest in (".npz.1a2b3c4d.partial", ".json.1a2b3c4d.partial", ".npz.partial"):
        (tmp_path / f"group0_epoch000001_cycle000001{rest}").touch()  # left by a kill -9
    for epoch, cycle in ((1, 0), (1, 1), (2, 0), (1_000_000, 3)):
        save(tmp_path, state, epoch, cycle)
    save(tmp_path, state, epoch=1, group=1)
    names = sorted(path.name for path in tmp_path.glob("*"))
    stems = (
        "group0_epoch000002_cycle000000",
        "group0_epoch1000000_cycle000003",
        "group1_epoch000001_cycle000000",
    )
    assert names == [f"{stem}{ending}" for stem in stems for ending in (".json", ".npz")]
    assert load(tmp_path)[0].epoch == 1_000_000


def flip(path: Path, place: int) -> None:
    data = bytearray(path.read_bytes())
    data[place] ^= 1
    path.write_bytes(data)


DAMAGE = {
    "a flipped byte in the middle": lambda path: flip(path, path.stat().st_size // 2),
    "a flipped byte at the end": lambda path: flip(path, -1),
    "a byte too few": lambda path: path.write_bytes(path.read_bytes()[:-1]),
    "an empty file": lambda path: path.write_bytes(b""),
    "a flipped byte in the manifest": lambda path: flip(path.with_suffix(".json"), 20),
    "an empty manifest": lambda path: path.with_suffix(".json").write_bytes(b""),
    "a manifest of another kind": lambda path: path.with_suffix(".json").write_text("[1]"),
}


@pytest.mark.parametrize("kind", DAMAGE)
def test_a_damaged_checkpoint_is_named_and_the_one_before_serves(
    kind: str, tmp_path: Path, state: TrainingState
) -> None:
    save(tmp_path, state, epoch=1)
    damaged = save(tmp_path, state, epoch=2)
    DAMAGE[kind](damaged)
    whole, complaints = last_whole(tmp_path, 0)
    assert (whole and position_of(whole), [*complaints]) == ((1, 0, 0), [damaged])
    training, (note,) = load(tmp_path)
    assert training.epoch == 1
    assert complaints[damaged] in note
    assert note.startswith(f"{damaged} is damaged (")
    assert not damaged.exists()  # set aside, so that it does not count as one of the two kept
    assert Path(f"{damaged}.damaged").exists()
    assert load(tmp_path)[1] == []


stale = refusing(errno.ESTALE)


@pytest.mark.parametrize(
    ("module", "name"),
    [(checkpoints, "read_json"), (hashlib, "file_digest"), (np.lib.format, "read_array")],
)
def test_a_checkpoint_that_cannot_be_read_just_now_stays_where_it_is(
    module: Any,
    name: str,
    tmp_path: Path,
    state: TrainingState,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    save(tmp_path, state, epoch=1)
    last = save(tmp_path, state, epoch=2)
    before = {path: path.read_bytes() for path in tmp_path.iterdir()}
    with monkeypatch.context() as patch:
        patch.setattr(module, name, stale)
        with pytest.raises(ReadError, match="Stale file handle") as caught:
            load(tmp_path)
    assert Path(caught.value.filename).stem == last.stem
    assert {path: path.read_bytes() for path in tmp_path.iterdir()} == before
    training, notes = load(tmp_path)
    assert (training.epoch, notes) == (2, [])


def test_a_checkpoint_that_was_never_finished_does_not_count(
    tmp_path: Path, state: TrainingState
) -> None:
    save(tmp_path, state, epoch=1)
    save(tmp_path, state, epoch=2).with_suffix(".json").unlink()
    training, notes = load(tmp_path)
    assert training.epoch == 1
    assert notes == []


def test_files_that_are_no_checkpoints_are_nobodys_business(
    tmp_path: Path, state: TrainingState
) -> None:
    kept = save(tmp_path, state, epoch=3)
    for name in ("group0_epochx_cycley", f"group0_epoch{'9' * 200}_cycle0", "group0_epoch_cycle"):
        for suffix in (".npz", ".json"):
            (tmp_path / f"{name}{suffix}").write_bytes(kept.with_suffix(suffix).read_bytes())
    assert finished_checkpoints(tmp_path) == finished_checkpoints(tmp_path, 0) == [kept]
    assert epochs_begun(tmp_path) == 3
    assert load(tmp_path)[0].epoch == 3


def test_a_part_of_a_cycle_begins_an_epoch(tmp_path: Path, state: TrainingState) -> None:
    whole = save(tmp_path, state, epoch=3)
    assert (epochs_begun(tmp_path), position_of(whole)) == (3, (3, 0, 0))
    later = save_checkpoint(tmp_path, 0, TrainingProgress(state, 3, 0, 12.5, ROWS, part=55))
    assert (epochs_begun(tmp_path), position_of(later)) == (4, (3, 0, 55))
    assert last_whole(tmp_path, 0) == (later, {})


def test_no_checkpoint_is_the_beginning(tmp_path: Path) -> None:
    assert load_checkpoint(tmp_path, 0, LIKE) == (None, [])


def test_the_state_of_another_program_is_refused(tmp_path: Path, state: TrainingState) -> None:
    save(tmp_path, state, epoch=1)
    other = stack([tiny(seed=i, hidden_layers=(8, 8)) for i in (0, 1)])
    like = jax.eval_shape(PROGRAMS.start, other)
    with pytest.raises(SettingError, match=r"resume: .* holds the state of another program"):
        load_checkpoint(tmp_path, 0, like)


def renumber(path: Path, number: Any) -> None:
    """Say that a checkpoint is of another format, or with None nothing, as format 1 did."""
    manifest = json.loads(path.with_suffix(".json").read_text())
    assert manifest.pop("format") == FORMAT
    entry = manifest if number is None else {**manifest, "format": number}
    path.with_suffix(".json").write_text(json.dumps(entry))


def test_a_checkpoint_of_the_first_format_is_read_where_its_arrays_fit(
    tmp_path: Path, state: TrainingState
) -> None:
    renumber(save(tmp_path, state, epoch=3), None)
    standing, notes = load(tmp_path)
    assert (standing.epoch, standing.rows, notes) == (3, ROWS, [])
    hyper = stack([tiny(seed=i, hidden_layers=(8, 8)) for i in (0, 1)])
    other = jax.eval_shape(PROGRAMS.start, hyper)
    older = "is a checkpoint of format 1, of an older version of cgm_jax, and holds the state of"
    with pytest.raises(SettingError, match=f"^resume: .*npz {older} another program"):
        load_checkpoint(tmp_path, 0, other)


def test_a_checkpoint_of_a_newer_format_is_refused_by_name_and_left_alone(
    tmp_path: Path, state: TrainingState
) -> None:
    save(tmp_path, state, epoch=1)
    path = save(tmp_path, state, epoch=2)
    renumber(path, FORMAT + 1)
    path.write_bytes(b"as nobody knows today")
    before = {file: file.read_bytes() for file in tmp_path.iterdir()}
    newer = f"checkpoint of format {FORMAT + 1}, of a newer version of cgm_jax; this one reads up"
    with pytest.raises(SettingError, match=f"^resume: {path} is a {newer} to format {FORMAT}$"):
        load(tmp_path)
    assert {file: file.read_bytes() for file in tmp_path.iterdir()} == before


@pytest.mark.parametrize("number", [0, -1, True, 1.5, "2", [2], {}])
def test_a_format_that_is_no_number_of_one_is_damage(
    number: Any, tmp_path: Path, state: TrainingState
) -> None:
    save(tmp_path, state, epoch=1)
    renumber(save(tmp_path, state, epoch=2), number)
    standing, (note,) = load(tmp_path)
    assert standing.epoch == 1
    assert f"is damaged (its format is {number!r})" in note


@pytest.mark.parametrize("number", ["x", True, [2]])
def test_a_foreign_checkpoint_whose_format_is_no_number_is_damage(
    number: Any, tmp_path: Path, state: TrainingState
) -> None:
    renumber(save(tmp_path, state, epoch=1), number)
    other = jax.eval_shape(PROGRAMS.start, stack([tiny(seed=0)]))
    check_last_checkpoint(tmp_path, 0, other)
    training, (note,) = load_checkpoint(tmp_path, 0, other)
    assert training is None
    assert f"is damaged (its format is {number!r})" in note


def test_damaged_bytes_under_the_right_checksum_are_refused(
    tmp_path: Path, state: TrainingState
) -> None:
    path = save(tmp_path, state, epoch=1)
    spoil(path)
    check_last_checkpoint(tmp_path, 0, LIKE)  # which reads no arrays
    line = rf"^resume: {path} is no file of arrays \(Bad CRC-32 for file .*\)$"
    with pytest.raises(SettingError, match=line):
        load(tmp_path)


def forge(path: Path, name: str, content: bytes) -> None:
    """Replace one member and make the manifest match."""
    with zipfile.ZipFile(path) as archive:
        members = {one: archive.read(one) for one in archive.namelist()}
    with zipfile.ZipFile(path, "w") as archive:
        for one, data in {**members, name: content}.items():
            archive.writestr(one, data)
    digest = hashlib.sha256(path.read_bytes()).hexdigest()
    entry = {"sha256": digest, "bytes": path.stat().st_size}
    path.with_suffix(".json").write_text(json.dumps(entry))


def header(shape: tuple[int, ...], kind: str) -> bytes:
    text = repr({"descr": kind, "fortran_order": False, "shape": shape}).encode() + b"\n"
    return b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("wall_s.npy", header((), "|O") + b"cos\nsystem\n(S'false'\ntR."),  # a pickle
        ("wall_s.npy", header((10**12,), "<f8")),  # terabytes, if one believes it
        (".env_steps.npy", header((2,), "<f4") + bytes(8)),  # another type
        (".env_steps.npy", header((-2,), "<i4") + bytes(8)),
        (".replay.episodes.mask.npy", header((2, 81, 2), "<f4") + bytes(2 * 81 * 8)),
        ("position.npy", header((2,), "<i8") + b"\xff" * 16),
        ("rows.npy", header((1,), "|u1") + b"\xff"),  # no text
        ("rows.npy", header((2,), "|u1") + b"[]"),  # no object
        ("wall_s.npy", b"nonsense"),
        ("more.npy", header((), "<f4") + bytes(4)),
    ],
)
def test_a_forged_checkpoint_is_refused_and_runs_no_code(
    name: str, content: bytes, tmp_path: Path, state: TrainingState
) -> None:
    forge(save(tmp_path, state, epoch=1), name, content)
    with pytest.raises(SettingError, match=r"resume: .*npz"):
        load_checkpoint(tmp_path, 0, LIKE)


def write_to_a_full_disk(file: Any, arrays: Any) -> None:
    file.write(b"as much as there is room for")
    del arrays
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def test_a_checkpoint_that_cannot_be_written_leaves_the_one_before(
    tmp_path: Path, state: TrainingState, monkeypatch: pytest.MonkeyPatch
) -> None:
    save(tmp_path, state, epoch=1)
    before = sorted(tmp_path.iterdir())
    monkeypatch.setattr(checkpoint, "write_arrays", write_to_a_full_disk)
    with pytest.raises(OSError, match="No space left on device"):
        save(tmp_path, state, epoch=2)
    monkeypatch.undo()
    assert sorted(tmp_path.iterdir()) == before
    assert load(tmp_path)[0].epoch == 1
