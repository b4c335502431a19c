"""Claiming a run directory, and reading what is in it."""

import contextlib
import errno
import json
from collections.abc import Iterator
from pathlib import Path

import pytest

from cgm_jax.config.fields import SettingError
from cgm_jax.config.grid import build_groups
from cgm_jax.storage import run_directory
from cgm_jax.storage.files import PARTIAL, ReadError
from cgm_jax.storage.layout import CONFIG
from cgm_jax.storage.run_directory import RunDirectory
from tests.cgm_jax.refusing import refusing


def test_whoever_claims_a_directory_removes_what_killed_processes_left_half_written(
    tmp_path: Path,
) -> None:
    with RunDirectory.claimed(tmp_path, fresh=True) as directory:
        directory.config.write(build_groups("smoke", {}), "smoke", "cpu")
    kept = {path for path in tmp_path.rglob("*") if path.is_file()}
    page = tmp_path / f"report.html.1a2b3c4d{PARTIAL}"  # which may be written just now
    names = ("config.json", "start.npz", "metrics.jsonl", "policies/a.npz", "figures/a.png")
    names += ("policies/improvements/a_epoch1.npz", "checkpoints/group0_epoch1_cycle0.npz")
    for name in names:
        (tmp_path / f"{name}.1a2b3c4d{PARTIAL}").touch()
        (tmp_path / f"{name}{PARTIAL}").touch()  # of versions before
    page.touch()
    with RunDirectory.claimed(tmp_path, fresh=False):
        pass
    assert {path for path in tmp_path.rglob("*") if path.is_file()} == kept | {page}


@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EIO])
@pytest.mark.parametrize("fresh", [True, False])
def test_a_disk_that_fails_is_no_bad_input(
    fresh: bool, number: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(run_directory, "locked", refusing(number))
    with pytest.raises(OSError) as caught, RunDirectory.claimed(tmp_path, fresh=fresh):  # noqa: PT011
        pass
    assert caught.value.errno == number


def test_a_directory_that_may_not_be_written_to_is_bad_input_unless_it_served_before(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(run_directory, "locked", refusing(errno.EACCES))
    line = f"^out: cannot write to {tmp_path}: Permission denied$"
    with pytest.raises(SettingError, match=line), RunDirectory.claimed(tmp_path, fresh=True):
        pass
    with pytest.raises(PermissionError), RunDirectory.claimed(tmp_path, fresh=False):
        pass


def test_metrics_that_cannot_be_read_are_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "metrics.jsonl").touch()

    stale = refusing(errno.ESTALE)

    monkeypatch.setattr(Path, "read_bytes", stale)
    for read in (RunDirectory(tmp_path).former_metrics, RunDirectory(tmp_path).count_metrics):
        with pytest.raises(ReadError) as caught:
            read()
        assert caught.value.filename == str(tmp_path / "metrics.jsonl")


def test_of_damaged_metrics_what_can_be_read_counts_once(tmp_path: Path) -> None:
    assert RunDirectory(tmp_path).former_metrics() == {}
    whole = {"success_rate": 0.5, "physics_warnings": 0, "failed_epoch": None, "failure": None}
    kept = [{"run": run, "epoch": epoch, **whole} for epoch in (1, 2) for run in "ab"]
    again = {**kept[0], "success_rate": 0.25}
    lines = [*map(json.dumps, [*kept, again]), "5", "[" * 10**5, '{"run": "a"}', '{"run": "a", "ep']
    (tmp_path / "metrics.jsonl").write_bytes(b"\xff\x00{\n" + "\n".join(lines).encode())
    found = RunDirectory(tmp_path).former_metrics()
    assert found == {"a": [again, kept[2]], "b": [kept[1], kept[3]]}


def test_epochs_that_are_no_numbers_do_not_count(tmp_path: Path) -> None:
    row = {"run": "a", "success_rate": 0.5, "physics_warnings": 0}
    row |= {"failed_epoch": None, "failure": None}
    epochs = [3, float("inf"), float("nan"), "9", None, True]
    lines = [json.dumps({**row, "epoch": epoch}) for epoch in epochs]
    (tmp_path / "metrics.jsonl").write_text("\n".join(lines))
    assert RunDirectory(tmp_path).epochs_begun() == 3


@pytest.mark.parametrize("name", [CONFIG, "metrics.jsonl"])
def test_a_directory_that_is_refused_is_left_as_it_was(name: str, tmp_path: Path) -> None:
    (tmp_path / name).write_text("theirs")
    with (
        pytest.raises(SettingError, match=f"^out: {tmp_path} already holds a sweep; name another"),
        RunDirectory.claimed(tmp_path, fresh=True),
    ):
        pass
    assert [path.name for path in tmp_path.iterdir()] == [name]
    assert (tmp_path / name).read_text() == "theirs"


@pytest.mark.parametrize(
    "name", ["metrics.csv", "figures/mine.png", "policies/a/b", "tracking/thesis.partial"]
)
def test_a_folder_with_files_where_a_sweep_writes_is_refused(name: str, tmp_path: Path) -> None:
    theirs = tmp_path / name
    theirs.parent.mkdir(parents=True, exist_ok=True)
    theirs.write_text("theirs")
    with (
        pytest.raises(
            SettingError, match=f"^out: {theirs} lies where a sweep writes; name another"
        ),
        RunDirectory.claimed(tmp_path, fresh=True),
    ):
        pass
    assert [path for path in tmp_path.rglob("*") if path.is_file()] == [theirs]
    assert theirs.read_text() == "theirs"


def test_a_folder_with_other_files_is_taken(tmp_path: Path) -> None:
    (tmp_path / "checkpoints").mkdir()
    (tmp_path / "logs").mkdir()
    for name in ("notes.txt", "report.html", "logs/1.log"):
        (tmp_path / name).write_text("theirs")
    with pytest.raises(SettingError, match=f"^out: {tmp_path}/logs/1.log lies where a sweep"):
        RunDirectory(tmp_path).check_fresh(also=("logs",))  # as of a launch
    with RunDirectory.claimed(tmp_path, fresh=True):
        assert (tmp_path / "notes.txt").read_text() == "theirs"


def test_what_another_process_has_begun_meanwhile_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    @contextlib.contextmanager
    def locked(path: Path) -> Iterator[None]:
        (path / CONFIG).write_text("theirs")
        yield

    monkeypatch.setattr(run_directory, "locked", locked)
    with (
        pytest.raises(SettingError, match=f"^out: {tmp_path} already holds a sweep; name another"),
        RunDirectory.claimed(tmp_path, fresh=True),
    ):
        pass


def test_metrics_that_were_set_aside_before_stay(tmp_path: Path) -> None:
    for number, text in enumerate(("a\n", "b\n"), start=1):
        (tmp_path / "metrics.jsonl").write_text(text)
        assert RunDirectory(tmp_path).set_metrics_aside() == tmp_path / f"metrics.jsonl.{number}"
    assert (tmp_path / "metrics.jsonl.1").read_text() == "a\n"
