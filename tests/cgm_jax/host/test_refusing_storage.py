"""A disk that is full, or that cannot be read or written just now: what is there goes on later."""

import contextlib
import errno
import hashlib
import os
import resource
import shutil
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from cgm_jax import sweep
from cgm_jax.host import beginning, session
from cgm_jax.storage import checkpoints, run_directory
from cgm_jax.storage.sweep_config import SweepConfig
from tests.cgm_jax.host.in_process import (
    ALWAYS,
    EPOCHS,
    OPTIONS,
    RUNS,
    at_epoch,
    stop_at_epoch,
    train,
)
from tests.cgm_jax.refusing import refusing
from tests.cgm_jax.sweeps import ROOT, assert_same_results, rows

pytestmark = pytest.mark.usefixtures("in_process")

stale, full = refusing(errno.ESTALE), refusing(errno.ENOSPC)


def test_a_sweep_that_could_not_begin_begins_in_the_same_directory_later(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    tracker = f"{ROOT / 'tests/examples/my_tracker.py'}:TextFile"
    with monkeypatch.context() as patch:
        patch.setattr(SweepConfig, "write", full)
        assert train(tmp_path, "--track", tracker) == 74
    assert capsys.readouterr().err.splitlines()[-1] == "nothing was begun"
    assert train(tmp_path, "--track", tracker) == 0


@pytest.mark.parametrize(
    ("module", "name", "file"),
    [
        (hashlib, "file_digest", "checkpoints/group0_epoch000003_cycle000000.npz"),
        (checkpoints, "read_json", "config.json"),
        (beginning, "load_checkpoint", None),
    ],
)
def test_what_cannot_be_read_just_now_ends_the_sweep_which_goes_on_from_it_later(
    module: Any,
    name: str,
    file: str | None,
    whole: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    out = tmp_path / "out"
    stop_at_epoch(monkeypatch, 3, out, *ALWAYS)
    before = {path: path.read_bytes() for path in (out / "checkpoints").iterdir()}
    capsys.readouterr()
    with monkeypatch.context() as patch:
        patch.setattr(module, name, stale)
        assert train(out) == 74
    what = f"write to {out}" if file is None else f"read {out / file}"
    error, advice = capsys.readouterr().err.splitlines()[-2:]
    assert error == f"error: cannot {what}: Stale file handle"
    assert advice == f"to resume: {sys.executable} -m cgm_jax.sweep --resume {out}"
    assert {path: path.read_bytes() for path in (out / "checkpoints").iterdir()} == before
    assert train(out) == 0
    assert_same_results(whole, out)


def test_a_full_disk_on_which_a_lost_config_cannot_come_back_ends_with_the_way_to_resume(
    whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    shutil.copytree(whole, out)
    (out / "config.json").unlink()
    with monkeypatch.context() as patch:
        patch.setattr(checkpoints, "replacing", full)
        assert train(out) == 74
    error, advice = capsys.readouterr().err.splitlines()
    assert error == f"error: cannot write to {out}: No space left on device"
    assert advice.startswith("to resume: ")
    assert train(out) == 0


def test_without_room_for_its_directory_nothing_is_begun(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    for module, name, out in (
        (run_directory, "locked", tmp_path / "out"),
        (session, "_made", None),
    ):
        with monkeypatch.context() as patch:
            patch.setattr(module, name, full)
            assert sweep.main([*OPTIONS, *(["--out", str(out)] if out else [])]) == 74
        assert capsys.readouterr().err.splitlines()[-2:] == [
            f"error: cannot write to {out or 'runs'}: No space left on device",
            "nothing was begun",
        ]


@contextlib.contextmanager
def file_sizes_limited_within() -> Iterator[Callable[[int], None]]:
    """Hands out a function that limits the size of files, a full disk as it were, for the block."""
    _, hard = before = resource.getrlimit(resource.RLIMIT_FSIZE)
    try:
        yield lambda size: resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


def test_a_full_disk_costs_checkpoints_but_not_the_training(
    whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    with monkeypatch.context() as patch, file_sizes_limited_within() as limit:
        at_epoch(patch, 2, lambda: limit(50_000))
        assert train(out, *ALWAYS) == 74  # its last checkpoint must be written
    text = capsys.readouterr().err
    assert "no checkpoint written (File too large); the one before stays, and training" in text
    assert f"error: cannot write to {out}: File too large\nto resume: " in text
    assert len(rows(out)) == EPOCHS * RUNS
    assert not list(out.rglob("*.partial"))
    assert list((out / "checkpoints").glob("*epoch000001*.json"))
    assert train(out) == 0
    assert_same_results(whole, out)


def test_without_room_for_its_config_nothing_is_begun_and_the_same_command_begins(
    whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"

    with monkeypatch.context() as patch:
        patch.setattr(SweepConfig, "replace", full)
        assert train(out) == 74
    lines = capsys.readouterr().err.splitlines()
    assert lines[-2:] == [
        f"error: cannot write to {out}: No space left on device",
        "nothing was begun",
    ]
    assert train(out) == 0
    assert_same_results(whole, out)


def test_metrics_that_cannot_be_written_end_the_sweep_which_can_go_on(
    whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    with monkeypatch.context() as patch, file_sizes_limited_within() as limit:
        # The next row will be torn.
        at_epoch(patch, 3, lambda: limit((out / "metrics.jsonl").stat().st_size + 100))
        assert train(out, *ALWAYS) == 74
    assert f"error: cannot write to {out}: File too large" in capsys.readouterr().err
    assert not (out / "metrics.jsonl").read_text().endswith("\n")
    assert train(out) == 0
    assert_same_results(whole, out)


@pytest.mark.skipif(os.geteuid() != 0, reason="needs to give up and take back rights")
def test_a_directory_that_becomes_read_only_costs_checkpoints_but_not_the_training(
    whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    out, nobody = tmp_path / "out", 65534
    out.mkdir()
    for path in (out, *out.parents):
        if path.is_relative_to(tmp_path.parents[2]):
            path.chmod(0o755)
    os.chown(out, nobody, nobody)
    with monkeypatch.context() as patch:
        at_epoch(patch, 2, lambda: (out / "checkpoints").chmod(0o555))
        os.seteuid(nobody)
        try:
            assert train(out, *ALWAYS) == 74
        finally:
            os.seteuid(0)
    assert "no checkpoint written (Permission denied); the one before" in capsys.readouterr().err
    assert len(rows(out)) == EPOCHS * RUNS
    (out / "checkpoints").chmod(0o755)
    assert train(out) == 0
    assert_same_results(whole, out)
