"""Files that were damaged or lost: what is left goes on."""

import os
import re
import shutil
import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from cgm_jax import sweep
from cgm_jax.storage.metrics import Row
from cgm_jax.storage.run_directory import RunDirectory
from tests.cgm_jax.host.in_process import (
    ALWAYS,
    EPOCHS,
    RUNS,
    at_epoch,
    stop_at_epoch,
    train,
)
from tests.cgm_jax.sweeps import assert_same_results, rows

pytestmark = pytest.mark.usefixtures("in_process")


DAMAGE_TO_METRICS: dict[str, Callable[[Path], Any]] = {
    "deleted": lambda path: path.unlink(),
    "empty": lambda path: path.write_text(""),
    "a torn last line": lambda path: path.write_bytes(path.read_bytes()[:-50]),
    "a line twice": lambda path: path.write_text(path.read_text() + path.read_text()),
    "nonsense": lambda path: path.write_bytes(b"\xff\x00{"),
}


@pytest.mark.parametrize("damage", DAMAGE_TO_METRICS)
def test_damaged_metrics_are_restored(
    damage: str, whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "out"
    stop_at_epoch(monkeypatch, 3, out)
    DAMAGE_TO_METRICS[damage](out / "metrics.jsonl")
    assert train(out) == 0
    assert_same_results(whole, out)


def test_a_damaged_checkpoint_is_named_and_the_sweep_goes_on_from_the_one_before(
    whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    stop_at_epoch(monkeypatch, 3, out, *ALWAYS)
    last = max((out / "checkpoints").glob("*.npz"))
    last.write_bytes(last.read_bytes()[:-1])
    assert train(out) == 0
    assert f"{last} is damaged" in capsys.readouterr().err
    assert_same_results(whole, out)


def test_without_any_checkpoint_the_group_begins_anew_and_says_so_and_keeps_old_metrics(
    whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    metrics, kept = out / "metrics.jsonl", []
    for number in (1, 2):
        stop_at_epoch(monkeypatch, 2, out)
        shutil.rmtree(out / "checkpoints")
        kept.append(metrics.read_bytes())
        assert len(kept[-1].splitlines()) == 2 * RUNS
        stop_at_epoch(monkeypatch, 1, out)
        aside = f"no checkpoint of group 0: it begins anew, and .* kept as {metrics}.{number}\n"
        assert re.search(aside, capsys.readouterr().err)
        shutil.rmtree(out / "checkpoints")
        metrics.write_bytes(b"")
    assert train(out) == 0
    assert "no checkpoint of group 0: it begins anew\n" in capsys.readouterr().err
    assert [Path(f"{metrics}.{number}").read_bytes() for number in (1, 2)] == kept
    assert_same_results(whole, out)


ONE_BY_ONE = ["--side-by-side", "1"]
"""A group for each run."""


def stop_last_group(monkeypatch: pytest.MonkeyPatch, epoch: int, out: Path) -> None:
    """Train a group for each run; stop the last one in the middle of an epoch."""
    groups = iter(range(RUNS))

    def stop() -> None:
        if next(groups) == RUNS - 1:
            os.kill(os.getpid(), signal.SIGTERM)

    with monkeypatch.context() as patch:
        at_epoch(patch, epoch, stop)
        assert train(out, *ONE_BY_ONE) == 75


@pytest.fixture(scope="module")
def names(whole: Path) -> list[str]:
    return [row["run"] for row in rows(whole)[:RUNS]]


def assert_keeps_metrics_aside(out: Path, group: int, capsys: pytest.CaptureFixture[str]) -> None:
    """Resume; one group begins anew, which is said, and the metrics until now are kept."""
    metrics = out / "metrics.jsonl"
    before = metrics.read_bytes()
    capsys.readouterr()
    assert train(out, *ONE_BY_ONE) == 0
    said = [line for line in capsys.readouterr().err.splitlines() if "begins anew" in line]
    kept = f"it begins anew, and the metrics until now are kept as {metrics}.1"
    assert said == [f"no checkpoint of group {group}: {kept}"]
    assert Path(f"{metrics}.1").read_bytes() == before


def test_rows_of_a_later_group_without_a_checkpoint_are_kept_aside(
    names: list[str],
    whole: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    out = tmp_path / "out"
    stop_last_group(monkeypatch, 3, out)
    for path in (out / "checkpoints").glob("group1_*"):
        path.unlink()
    assert [row["run"] for row in rows(out)] == [names[0]] * EPOCHS + [names[1]] * 3
    assert_keeps_metrics_aside(out, 1, capsys)
    expected = sorted(rows(whole), key=lambda row: names.index(row["run"]))
    assert rows(out) == expected


def test_lines_that_are_no_rows_of_the_sweep_are_kept_aside_when_a_group_begins_anew(
    names: list[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    out = tmp_path / "out"
    stop_last_group(monkeypatch, 3, out)
    for path in (out / "checkpoints").glob("group0_*"):
        path.unlink()
    metrics = out / "metrics.jsonl"
    last = [line for line in metrics.read_text().splitlines(True) if names[1] in line]
    metrics.write_text("".join(["no JSON any more\n", *last]))
    assert_keeps_metrics_aside(out, 0, capsys)
    assert [(row["run"], row["epoch"]) for row in rows(out)] == [
        (name, epoch) for name in names for epoch in range(1, EPOCHS + 1)
    ]


def test_rows_of_later_groups_stay_while_earlier_ones_are_trained_for_longer(
    names: list[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    out = tmp_path / "out"
    assert train(out, *ONE_BY_ONE) == 0
    before = rows(out)
    longer = ["--resume", str(out), "--epochs", "6"]
    with monkeypatch.context() as patch:
        at_epoch(patch, 5, lambda: os.kill(os.getpid(), signal.SIGTERM))
        assert sweep.main(longer) == 75
    meanwhile = rows(out)
    assert meanwhile[: len(before)] == before
    assert [(row["run"], row["epoch"]) for row in meanwhile[len(before) :]] == [(names[0], 5)]
    (out / "config.json").unlink()  # the last group's checkpoint has that of four epochs
    assert sweep.main(["--resume", str(out)]) == 0
    assert [(row["run"], row["epoch"]) for row in rows(out)] == [
        (name, epoch) for name in names for epoch in range(1, 7)
    ]
    assert "begins anew" not in capsys.readouterr().err


@pytest.mark.parametrize("damage", ["cut", "deleted"])
def test_a_damaged_config_comes_back_from_a_checkpoint(
    damage: str,
    whole: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    out = tmp_path / "out"
    stop_at_epoch(monkeypatch, 3, out, *ALWAYS)
    config = out / "config.json"
    content = config.read_bytes()
    last = max((out / "checkpoints").glob("*.npz"))
    last.write_bytes(last.read_bytes()[:-1])  # so that the one before must serve
    if damage == "cut":
        config.write_bytes(content[:100])
    else:
        config.unlink()
    assert sweep.main(["--resume", str(out)]) == 0
    text = capsys.readouterr().err
    assert f"{config} was {'damaged' if damage == 'cut' else 'missing'}" in text
    assert "restored from " in text
    assert config.read_bytes() == content
    assert_same_results(whole, out)


def test_resuming_what_is_done_writes_its_rows_once_however_many_groups_there_are(
    names: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert train(tmp_path, *ONE_BY_ONE) == 0
    before, replace_metrics, calls = rows(tmp_path), RunDirectory.replace_metrics, []

    def counted(self: RunDirectory, rows: list[Row]) -> None:
        calls.append(len(rows))
        replace_metrics(self, rows)

    monkeypatch.setattr(RunDirectory, "replace_metrics", counted)
    assert sweep.main(["--resume", str(tmp_path)]) == 0
    assert calls == [EPOCHS * RUNS]
    assert rows(tmp_path) == before
