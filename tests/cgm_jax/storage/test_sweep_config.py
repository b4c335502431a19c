"""What a sweep was trained with, as its config has it, and what has changed since."""

import json
import os
import subprocess
import sys
from hashlib import sha256
from pathlib import Path

import pytest

from cgm_jax.config.fields import SettingError
from cgm_jax.config.grid import build_groups
from cgm_jax.config.named import load_named, name_now, note_hosted
from cgm_jax.storage import provenance
from cgm_jax.storage.layout import CONFIG
from cgm_jax.storage.run_directory import RunDirectory
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


def test_what_a_hosted_task_runs_on_is_recorded_and_its_changes_are_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    name, file = "gymnasium:mine:Reach-v0", tmp_path / "mine.py"
    file.write_text("X = 1\n")
    groups = build_groups("smoke", {"env": [name]})
    note_hosted(name, {str(file): sha256(b"X = 1\n").hexdigest()}, {"mujoco": "3.3.2"})
    monkeypatch.setenv("CGM_JAX_GYMNASIUM_PYTHON", "/other/bin/python")
    with RunDirectory.claimed(tmp_path / "out", fresh=True) as found:
        found.config.write(groups, "smoke", "cpu")
    assert found.config.changes_since_begun("cpu", groups, {}) == []
    file.write_text("X = 2\n")
    note_hosted(name, {}, {"mujoco": "3.3.7"})
    monkeypatch.delenv("CGM_JAX_GYMNASIUM_PYTHON")
    changed_file, *others = found.config.changes_since_begun("cpu", groups, {})
    assert changed_file.startswith(f"{file} with SHA-256 ")
    assert others == [
        "CGM_JAX_GYMNASIUM_PYTHON /other/bin/python (now none)",
        f"mujoco of {name} 3.3.2 (now 3.3.7)",
    ]


def test_a_hosted_task_that_is_named_again_runs_on_what_it_did(tmp_path: Path) -> None:
    old, new = "gymnasium:one:Reach-v0", "gymnasium:two:Reach-v0"
    note_hosted(old, {}, {"mujoco": "3.3.2"})
    with RunDirectory.claimed(tmp_path, fresh=True) as found:
        found.config.write(build_groups("smoke", {"env": [old]}), "smoke", "cpu")
    note_hosted(new, {}, {"mujoco": "3.3.2"})
    groups, moved = build_groups("smoke", {"env": [new]}), {old: new}
    changes = found.config.changes_since_begun("cpu", groups, moved)
    assert changes == [f"{old} (now {new})"]
    found.config.record_resumption(changes, moved)
    recorded = json.loads((tmp_path / CONFIG).read_text())["hosted"]
    assert recorded == {f"mujoco of {new}": "3.3.2"}
