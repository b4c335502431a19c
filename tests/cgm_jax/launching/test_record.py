"""The record of a part's attempts, and how far they have come."""

import errno
from pathlib import Path

import pytest

from cgm_jax.launching import attempts
from cgm_jax.launching.record import append_event, fruitless_attempts, last_code, position
from cgm_jax.storage.lock import locked
from tests.cgm_jax.refusing import refusing


def test_attempts_that_end_within_one_long_cycle_come_further(folder: Path) -> None:
    (folder / "checkpoints").mkdir()
    record = folder / "record"
    for part in (7, 19):
        append_event(record, "started", position=position(folder))
        assert fruitless_attempts(record, folder) == 1
        name = f"group0_epoch000000_cycle000000_part{part:06d}.json"
        (folder / "checkpoints" / name).touch()
        assert position(folder) == [0, 0, 0, part]
        assert fruitless_attempts(record, folder) == 0
    (folder / "checkpoints" / "group0_epoch000000_cycle000001.json").touch()
    assert position(folder) == [0, 0, 1, 0]


def test_what_is_no_checkpoint_or_no_event_is_passed_over(folder: Path) -> None:
    (folder / "checkpoints").mkdir()
    for name in ("group0_epochx_cycley", "group0_epoch000001_cycle000002", f"group{'9' * 5000}"):
        (folder / "checkpoints" / f"{name[:200]}.json").touch()
    assert position(folder) == [0, 1, 2, 0]
    record = folder / "record"
    record.write_text('{"event": "ended", "code": "high"}\n' + "[" * 10**5 + "\n")
    assert last_code(record) is None


def test_a_disk_that_is_away_for_a_moment_ends_no_launcher(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (folder / "checkpoints").mkdir()
    with monkeypatch.context() as patch:
        patch.setattr(Path, "iterdir", refusing(errno.ESTALE))
        assert position(folder) == []
    with monkeypatch.context() as patch:
        patch.setattr(Path, "is_dir", refusing(errno.ESTALE))
        assert attempts._in_use(folder) is False
    assert attempts._in_use(folder) is False
    with locked(folder):
        assert attempts._in_use(folder) is True
