"""What is damage of a checkpoint or a config, and what only cannot be read just now."""

import errno
import hashlib
import json
from pathlib import Path
from typing import Any

import pytest

from cgm_jax.storage import checkpoints
from cgm_jax.storage.checkpoints import (
    damage,
    epochs_begun,
    finished_checkpoints,
    format_of,
    holds_config,
    manifest_path,
    restore_config,
    write_manifest,
)
from cgm_jax.storage.files import ReadError
from tests.cgm_jax.refusing import refusing

CONFIG = b'{"format": 2}\n'

stale = refusing(errno.ESTALE)


@pytest.fixture
def checkpoint(tmp_path: Path) -> Path:
    """A finished one, as far as files tell."""
    path = tmp_path / "checkpoints" / "group0_epoch000001_cycle000000.npz"
    path.parent.mkdir()
    path.write_bytes(b"whole")
    write_manifest(path, hashlib.sha256(b"whole").hexdigest(), len(b"whole"), CONFIG)
    return path


def test_a_file_that_is_gone_is_damage(checkpoint: Path) -> None:
    assert damage(checkpoint) is None
    checkpoint.unlink()
    assert damage(checkpoint) == "No such file or directory"
    manifest_path(checkpoint).unlink()
    assert damage(checkpoint) == "its manifest cannot be read"
    assert finished_checkpoints(checkpoint.parent) == []
    assert finished_checkpoints(checkpoint.parent / "none") == []


def test_bytes_that_cannot_be_read_just_now_are_no_damage(
    checkpoint: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(checkpoints.hashlib, "file_digest", stale)
    with pytest.raises(ReadError) as caught:
        damage(checkpoint)
    assert (caught.value.errno, caught.value.filename) == (errno.ESTALE, str(checkpoint))


def test_a_manifest_that_cannot_be_read_just_now_is_no_damage(
    checkpoint: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(checkpoints, "read_json", stale)
    for read in (damage, format_of):
        with pytest.raises(ReadError) as caught:
            read(checkpoint)
        assert caught.value.filename == str(manifest_path(checkpoint))
    assert holds_config(checkpoint.parent) is False  # which is only a hint


def test_a_directory_that_cannot_be_read_just_now_is_not_empty(
    checkpoint: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Path, "iterdir", stale)
    with pytest.raises(ReadError) as caught:
        finished_checkpoints(checkpoint.parent)
    assert caught.value.filename == str(checkpoint.parent)


def test_a_config_that_cannot_be_read_just_now_is_left_alone(
    checkpoint: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    config = tmp_path / "config.json"
    config.write_bytes(b'{"format": 2, "edited": true}')
    before = sorted(tmp_path.rglob("*"))
    with monkeypatch.context() as patch:
        patch.setattr(checkpoints, "read_json", stale)
        with pytest.raises(ReadError) as caught:
            restore_config(config, checkpoint.parent)
    assert caught.value.filename == str(config)
    assert sorted(tmp_path.rglob("*")) == before
    assert json.loads(config.read_bytes())["edited"]


def test_files_beyond_all_measure_are_damage_and_are_not_read(
    checkpoint: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    config = tmp_path / "config.json"
    with config.open("wb") as file:
        file.truncate(checkpoints.MAX_CONFIG_BYTES + 1)
    read = Path.read_bytes

    def read_small(path: Path) -> bytes:
        assert path.stat().st_size < 2**20
        return read(path)

    monkeypatch.setattr(Path, "read_bytes", read_small)
    line = restore_config(config, checkpoint.parent)
    assert line is not None
    assert f"was damaged and is set aside as {config}.damaged; restored from {checkpoint}" in line
    assert config.read_bytes() == CONFIG
    with manifest_path(checkpoint).open("r+b") as file:
        file.truncate(checkpoints.MAX_MANIFEST_BYTES + 1)
    assert damage(checkpoint) == "its manifest cannot be read"
    assert holds_config(checkpoint.parent) is False


def test_an_epoch_of_whose_first_cycle_parts_are_done_has_begun(tmp_path: Path) -> None:
    for name in ("group0_epoch000002_cycle000000_part000003", "group1_epoch000001_cycle000004"):
        (tmp_path / f"{name}.npz").touch()
        (tmp_path / f"{name}.json").touch()
    assert epochs_begun(tmp_path) == 3


def test_a_config_that_is_damaged_beside_its_checkpoint_is_not_restored(tmp_path: Path) -> None:
    path = tmp_path / "group0_epoch000001_cycle000000.npz"
    path.touch()
    write_manifest(path, "0" * 64, 0, b'{"groups": []}')
    assert holds_config(tmp_path)
    entry = json.loads(manifest_path(path).read_text())
    manifest_path(path).write_text(json.dumps(entry | {"config": '{"groups": [1]}'}))
    assert not holds_config(tmp_path)


def finished(folder: Path, group: int, epoch: int, config: dict[str, Any]) -> Path:
    path = folder / f"group{group}_epoch{epoch:06d}_cycle000000.npz"
    path.touch()
    write_manifest(path, hashlib.sha256(b"").hexdigest(), 0, json.dumps(config).encode())
    return path


def test_the_config_that_knows_of_most_resumptions_comes_back(tmp_path: Path) -> None:
    extended = {"epochs": 6, "resumed": [{"changed": ["epochs"]}]}
    latest = finished(tmp_path, 0, 5, extended)
    finished(tmp_path, 1, 4, {"epochs": 4})  # which is done, and has yet to be trained for longer
    line = restore_config(tmp_path / "config.json", tmp_path)
    assert line is not None
    assert line.endswith(f"restored from {latest}")
    assert json.loads((tmp_path / "config.json").read_text()) == extended


def test_a_merged_config_comes_back_only_where_all_groups_have_a_checkpoint(tmp_path: Path) -> None:
    merged = {"parts": [{}, {}], "groups": [{}, {}]}
    finished(tmp_path, 0, 2, merged)
    assert restore_config(tmp_path / "config.json", tmp_path) is None
    assert not holds_config(tmp_path)
    finished(tmp_path, 1, 2, merged)
    assert holds_config(tmp_path)
    assert restore_config(tmp_path / "config.json", tmp_path) is not None
