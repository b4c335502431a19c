import contextlib
import errno
import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from cgm_jax.config.fields import SettingError
from cgm_jax.config.grid import build_groups
from cgm_jax.config.named import load_named, name_now
from cgm_jax.launching.directory import read_launch
from cgm_jax.storage import provenance, run_directory
from cgm_jax.storage.files import PARTIAL, ReadError
from cgm_jax.storage.layout import CONFIG
from cgm_jax.storage.run_directory import RunDirectory
from tests.cgm_jax.refusing import refusing
from tests.cgm_jax.sweeps import ROOT


@pytest.mark.skipif(not (ROOT / ".git").exists(), reason="no checkout")
def test_the_config_names_the_commit_that_trains(tmp_path: Path) -> None:
    provenance._commit.cache_clear()  # another test may have asked ahead of a new commit
    with RunDirectory.claimed(tmp_path, fresh=True) as directory:
        directory.config.write(build_groups("smoke", {}), "smoke", "cpu")
    command = ["git", "-C", str(ROOT), "rev-parse", "HEAD"]
    head = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    commit = json.loads((tmp_path / CONFIG).read_text())["commit"]
    assert head.startswith(commit.removesuffix("-dirty"))


@pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="processes cannot be bound")
def test_the_config_tells_on_how_many_cores_its_seconds_were_spent(tmp_path: Path) -> None:
    program = """
import os, pathlib, sys
from cgm_jax.config.grid import build_groups
from cgm_jax.storage.run_directory import RunDirectory
os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[:1])
with RunDirectory.claimed(pathlib.Path(sys.argv[1]), fresh=True) as directory:
    directory.config.write(build_groups("smoke", {}), "smoke", "cpu")
"""
    subprocess.run([sys.executable, "-c", program, str(tmp_path)], check=True, cwd=ROOT)
    machine = json.loads((tmp_path / CONFIG).read_text())["machine"]
    there = os.cpu_count()
    assert machine.endswith(", 1 cores" if there == 1 else f", 1 of {there} cores")


def test_what_has_changed_since_a_sweep_was_begun_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    groups = build_groups("smoke", {})
    with RunDirectory.claimed(tmp_path, fresh=True) as directory:
        directory.config.write(groups, "smoke", "1 x cpu")
    assert directory.config.changes_since_begun("1 x cpu", groups, {}) == []
    config = json.loads((tmp_path / CONFIG).read_text())
    then = {
        "python": "2.7",
        "commit": "0123\x1b[31m",  # could colour a terminal
        "flags": "--xla_fast",
        "machine": "another, 2 cores",
        "variables": {"JAX_THEN": "1"},
    }
    config = {**config, **then, "versions": {**config["versions"], "jax": "0.0.1"}}
    now = json.loads((tmp_path / CONFIG).read_text())
    (tmp_path / CONFIG).write_text(json.dumps(config))
    for name in os.environ:
        if name.startswith("JAX_"):
            monkeypatch.delenv(name)
    monkeypatch.setenv("JAX_NOW", "x")
    changes = directory.config.changes_since_begun("8 x gpu", groups, {})
    assert changes == [
        f"jax 0.0.1 (now {now['versions']['jax']})",
        "JAX_NOW none (now x)",
        "JAX_THEN 1 (now none)",
        f"Python 2.7 (now {now['python']})",
        f"commit 0123?[31m (now {now['commit'] or 'none'})",
        "device 1 x cpu (now 8 x gpu)",
        f"XLA_FLAGS --xla_fast (now {now['flags'] or 'none'})",
        f"another, 2 cores (now {now['machine']})",
    ]
    directory.config.record_resumption(changes, {})
    assert json.loads((tmp_path / CONFIG).read_text())["resumed"][0]["changed"] == changes


def test_another_number_of_cores_changes_nothing(tmp_path: Path) -> None:
    groups = build_groups("smoke", {})
    with RunDirectory.claimed(tmp_path, fresh=True) as directory:
        directory.config.write(groups, "smoke", "cpu")
    config = json.loads((tmp_path / CONFIG).read_text())
    system = config["machine"].rpartition(", ")[0]
    config["machine"] = f"{system}, 3 of 4096 cores"
    (tmp_path / CONFIG).write_text(json.dumps(config))
    assert directory.config.changes_since_begun("cpu", groups, {}) == []


def own_sweep(tmp_path: Path) -> tuple[Path, RunDirectory]:
    """A sweep on an environment of one's own, with a neighbour, both of which have run."""
    file = tmp_path / "mine" / "env.py"
    file.parent.mkdir()
    file.write_text("import beside\ndef Make(): return beside\n")
    (file.parent / "beside.py").write_text("X = 1\n")
    groups = build_groups("smoke", {"env": [f"{file}:Make"]})
    name_now(f"{file}:Make")
    load_named("env", f"{file}:Make")
    with RunDirectory.claimed(tmp_path / "out", fresh=True) as directory:
        directory.config.write(groups, "smoke", "cpu")
    return file, directory


def test_a_file_of_ones_own_that_has_changed_is_named(tmp_path: Path) -> None:
    file, directory = own_sweep(tmp_path)
    groups = directory.config.groups()
    assert directory.config.changes_since_begun("cpu", groups, {}) == []
    recorded = json.loads((directory.path / CONFIG).read_text())["files"]
    assert sorted(recorded) == [str(file.parent / "beside.py"), str(file)]
    (file.parent / "beside.py").write_text("X = 2\n")
    (change,) = directory.config.changes_since_begun("cpu", groups, {})
    assert change.startswith(f"{file.parent / 'beside.py'} with SHA-256 ")


def test_a_file_of_ones_own_that_has_moved_is_named_again(tmp_path: Path) -> None:
    file, directory = own_sweep(tmp_path)
    old, new = f"{file}:Make", f"{tmp_path / 'moved' / 'other.py'}:Make"
    file.parent.rename(tmp_path / "moved")
    (tmp_path / "moved" / "env.py").rename(tmp_path / "moved" / "other.py")
    with pytest.raises(SettingError, match="if it has moved, name it: --env"):
        directory.config.groups()
    moved = directory.config.moved({"env": [new], "curriculum": []})
    assert moved == {old: new}
    name_now(new)
    groups = directory.config.groups(moved)
    assert groups[0].settings.env == new
    load_named("env", new)
    changes = directory.config.changes_since_begun("cpu", groups, moved)
    assert changes == [f"{old} (now {new})"]
    directory.config.record_resumption(changes, moved)
    assert directory.config.moved({"env": [new]}) == {}
    assert directory.config.changes_since_begun("cpu", directory.config.groups(), {}) == []


@pytest.mark.parametrize(
    ("kind", "text"), [("env", "/x/y.py:Other"), ("env", "push"), ("agent", "/x/y.py:Make")]
)
def test_what_a_sweep_was_not_trained_with_cannot_be_named(
    kind: str, text: str, tmp_path: Path
) -> None:
    _, directory = own_sweep(tmp_path)
    with pytest.raises(SettingError, match=f"^{kind}: .* was trained with .*, not {text}$"):
        directory.config.moved({kind: [text]})


NAMES = [
    *("../../../escape", "/escape", "a/b", "a\\b", "a\0b", "a\nb", "", "x" * 300, "\ud800"),
    *("\x1b[31m", 5, None, ["a"], {"a": 1}),
]


@pytest.mark.parametrize("name", NAMES)
def test_names_of_runs_never_leave_the_directory(name: Any, tmp_path: Path) -> None:
    with RunDirectory.claimed(tmp_path, fresh=True) as directory:
        directory.config.write(build_groups("smoke", {}), "smoke", "cpu")
    config = json.loads((tmp_path / CONFIG).read_text())
    config["groups"][0]["runs"][0]["name"] = name
    (tmp_path / CONFIG).write_text(json.dumps(config))
    with pytest.raises(SettingError, match=r"config.json is damaged: run: .* is no name for a"):
        directory.config.groups()


LINKS = [
    *("policies", "policies/x.npz", "policies/x.npz.partial", "checkpoints/x.npz"),
    *("metrics.jsonl", "lock", "holder", CONFIG),
]


@pytest.mark.parametrize("link", LINKS)
def test_a_directory_with_a_link_is_neither_read_nor_written(link: str, tmp_path: Path) -> None:
    out, target = tmp_path / "out", tmp_path / "target"
    with RunDirectory.claimed(out, fresh=True) as directory:
        directory.config.write(build_groups("smoke", {}), "smoke", "cpu")
    target.write_bytes((out / CONFIG).read_bytes())
    if link == "policies":
        shutil.rmtree(out / link)
    (out / link).unlink(missing_ok=True)
    (out / link).symlink_to(target)
    before = target.read_bytes()
    complaint = f"{out / link} is a symbolic link, which a run directory may not hold"
    with pytest.raises(SettingError, match=re.escape(complaint)):
        RunDirectory.open(out)
    with pytest.raises(SettingError, match=re.escape(complaint)):
        RunDirectory(out).config.restore()
    with (
        pytest.raises(SettingError, match=re.escape(complaint)),
        RunDirectory.claimed(out, fresh=False),
    ):
        pass
    assert target.read_bytes() == before


NO_SWEEP = {
    "nowhere": "there is no directory {path}",
    "sweep/config.json": "{path} is no directory",
    "sweep/config.json/x": "there is no directory {path}",
    "x" * 300: "cannot look at {path}: File name too long",
    "empty": "{path} holds no sweep: config.json is missing",
    "launch": "{path} holds no sweep, but a launch, whose parts are in {path}/parts; to resume it: "
    "{python} -m cgm_jax.launch --resume {path}",
}
NO_LAUNCH = {
    "nowhere": "resume: there is no directory {path}",
    "empty": "resume: {path} holds no launch: launch.json is missing",
    "sweep": "resume: {path} holds no launch, but a sweep; to resume it: "
    "{python} -m cgm_jax.sweep --resume {path}",
}


@pytest.mark.parametrize(
    ("opened", "name", "line"),
    [
        *((RunDirectory.open, *item) for item in NO_SWEEP.items()),
        *((read_launch, *item) for item in NO_LAUNCH.items()),
    ],
)
def test_what_is_there_instead_of_a_sweep_or_a_launch_is_said(
    opened: Callable[[Path], object], name: str, line: str, tmp_path: Path
) -> None:
    for file in ("launch/launch.json", "sweep/config.json", "empty/other"):
        (tmp_path / file).parent.mkdir()
        (tmp_path / file).write_text("{}")
    with pytest.raises(SettingError) as refused:
        opened(tmp_path / name)
    assert str(refused.value) == line.format(path=tmp_path / name, python=sys.executable)


def test_a_link_to_a_run_directory_is_fine(tmp_path: Path) -> None:
    with RunDirectory.claimed(tmp_path / "out", fresh=True) as directory:
        directory.config.write(build_groups("smoke", {}), "smoke", "cpu")
    (tmp_path / "link").symlink_to(tmp_path / "out")
    assert len(RunDirectory.open(tmp_path / "link").config.groups()[0].runs) == 2


def test_of_a_trackers_files_only_the_link_beside_wandbs_log_may_be_one(tmp_path: Path) -> None:
    with RunDirectory.claimed(tmp_path / "out", fresh=True) as directory:
        directory.config.write(build_groups("smoke", {}), "smoke", "cpu")
    logs = tmp_path / "out/tracking/wandb/wandb/offline-run-1/logs"
    logs.mkdir(parents=True)
    (logs / "debug-core.log").symlink_to(tmp_path / "log")
    RunDirectory.open(tmp_path / "out")
    for link in ("tracking/debug-core.log", "tracking/tensorboard"):
        (tmp_path / "out" / link).symlink_to(tmp_path)
        with pytest.raises(SettingError, match=f"{link} is a symbolic link"):
            RunDirectory.open(tmp_path / "out")
        (tmp_path / "out" / link).unlink()


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


CONFIGS = {
    "{}": "KeyError",
    "[]": "AttributeError",
    "5": "AttributeError",
    '{"format": 2, "groups": []}': "it needs runs",
    '{"format": 2, "groups": [{"runs": []}]}': "ValueError",
    '{"format": 2, "groups": {"a": 1}}': "TypeError",
    '{"format": 2, "groups": [{"runs": [5]}]}': "TypeError",
    '{"format": 2, "groups": [{"runs": [{"name": "a", "env": 5}]}]}': "env: 5 is not of type str",
    '{"format": 2, "groups": [{"runs": [{"name": "a", "epochs": 1e999}]}]}': "epochs: inf",
    '{"format": 2, "groups": [{"runs": [{"name": "a", "agent": ["b"]}]}]}': "agent: ",
    '{"format": 2, "groups": [{"runs": [{"name": "a"}, {"name": "a"}]}]}': "name of its own",
    "[" * 100_000: "RecursionError",
    '{"format": 2, "groups": ' + "[" * 900 + "]" * 900 + "}": "Error",
    '{"x": ' + "[" * 400 + "]" * 400 + "}": "RecursionError",
    "9" * 5000: "ValueError",
    "\xff": "Error",
}


@pytest.mark.parametrize("text", CONFIGS, ids=range(len(CONFIGS)))
def test_hostile_configs_are_refused_in_one_line(text: str, tmp_path: Path) -> None:
    (tmp_path / CONFIG).write_bytes(text.encode("latin-1"))
    directory = RunDirectory.open(tmp_path)
    for read in (
        directory.config.groups,
        lambda: directory.config.moved({"env": ["a.py:B"]}) or directory.config.groups(),
    ):
        with pytest.raises(SettingError) as caught:
            read()
        assert "\n" not in str(caught.value)
    with pytest.raises(SettingError, match=f"config.json is damaged: .*{CONFIGS[text]}"):
        directory.config.groups()


def test_a_config_beyond_all_measure_is_not_read(tmp_path: Path) -> None:
    with (tmp_path / CONFIG).open("wb") as file:
        file.truncate(2**30)
    with pytest.raises(SettingError, match="it has more than 268,435,456 bytes"):
        RunDirectory.open(tmp_path).config.groups()


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
