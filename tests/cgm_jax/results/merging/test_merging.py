"""Parts of a sweep, made up, put together; real ones are in launching/test_launch.py."""

import csv
import errno
import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from cgm_jax.config.fields import SettingError
from cgm_jax.config.grid import build_groups
from cgm_jax.config.named import load_named, name_now
from cgm_jax.host.settings_file import read_settings_file
from cgm_jax.storage import checkpoints, run_directory
from cgm_jax.storage.checkpoints import FORMAT, damage, finished_checkpoints, format_of
from cgm_jax.storage.run_directory import RunDirectory
from tests.cgm_jax.refusing import refusing
from tests.cgm_jax.results.merging.made_parts import (
    EPOCHS,
    OPTIONS,
    run,
    train,
    whole,
)
from tests.cgm_jax.sweeps import POINT_MASS, rows

POINT_MASS_FILE = Path(POINT_MASS.partition(":")[0])


def test_merged_parts_are_one_sweep(parts: list[Path], tmp_path: Path) -> None:
    out = tmp_path / "new" / "out"
    first, second, third = parts
    assert run(third, first, second, "--out", out) == 0
    directory = RunDirectory.open(out)
    names = [r.name for group in whole() for r in group.runs]
    assert [r.name for group in directory.config.groups() for r in group.runs] == names
    assert directory.config.shard() is None
    assert rows(out) == [entry for part in parts for entry in rows(part)]
    assert len(rows(out)) == len(names) * EPOCHS
    for number, name in enumerate(names):
        part = number // 2 + 1
        with np.load(out / "policies" / f"{name}.npz") as file:
            assert file["part"] == part
        with np.load(out / "policies/improvements" / f"{name}_epoch1.npz") as file:
            assert file["part"] == 10 + part
    found = finished_checkpoints(out / "checkpoints")
    assert [path.name.partition("_")[0] for path in found] == [f"group{i}" for i in range(4)]
    assert [damage(path) for path in found] == [None] * 4  # the second part has two programs
    (out / "config.json").write_text("{")  # comes back from a checkpoint, whole
    assert directory.config.restore() is not None
    assert [r.name for group in directory.config.groups() for r in group.runs] == names
    assert not list(tmp_path.glob("new/.*"))


def test_what_parts_began_from_goes_along(tmp_path: Path) -> None:
    places = {1: "/there", 2: "/on/another/machine"}
    parts = [
        train(tmp_path / f"part{i}", whole(), i, 2, start=(place, 7)) for i, place in places.items()
    ]
    out = tmp_path / "out"
    assert run(*parts, "--out", out) == 0
    assert (out / "start.npz").read_bytes() == (parts[1] / "start.npz").read_bytes()
    config = json.loads((out / "config.json").read_text())
    told = [config["from"], *(part["from"] for part in config["parts"])]
    assert told == ["/there", "/there", "/on/another/machine"]
    assert read_settings_file(out).start == out / "start.npz"  # which trains it again


def test_a_full_disk_ends_a_merge_with_74_and_leaves_nothing(
    parts: list[Path],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    full = refusing(errno.ENOSPC)

    before = sorted(tmp_path.rglob("*"))
    for module, name in ((run_directory, "locked"), (checkpoints, "replacing")):
        with monkeypatch.context() as patch:
            patch.setattr(module, name, full)
            assert run(*parts, "--out", tmp_path / "out") == 74
        line = f"error: cannot write to {tmp_path / 'out'}: No space left on device\n"
        assert capsys.readouterr().err == line
        assert sorted(tmp_path.rglob("*")) == before


def test_where_a_part_has_a_table_the_whole_has_one(parts: list[Path], tmp_path: Path) -> None:
    assert run(*parts, "--out", tmp_path / "without") == 0
    assert not (tmp_path / "without/metrics.csv").exists()
    command = json.loads((tmp_path / "without/config.json").read_text())["command"]
    words = [*map(str, parts), "--out", str(tmp_path / "without")]
    assert command == ["python", "-m", "cgm_jax.merge", *words]
    RunDirectory(parts[1]).write_csv()
    assert run(*parts, "--out", tmp_path / "with") == 0
    with (tmp_path / "with/metrics.csv").open() as file:
        table = [(row["run"], int(row["epoch"])) for row in csv.DictReader(file)]
    assert table == [(row["run"], row["epoch"]) for row in rows(tmp_path / "with")]


def test_each_part_keeps_what_it_was_trained_with(
    parts: list[Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    config = json.loads((parts[1] / "config.json").read_text())
    config["versions"]["numpy"] = "1.0"
    config["started"] = "2020-02-02T20:20:20"
    (parts[1] / "config.json").write_text(json.dumps(config))
    assert run(*parts, "--out", tmp_path / "out") == 0
    assert "bits may differ: parts differ in versions" in capsys.readouterr().err
    merged = json.loads((tmp_path / "out" / "config.json").read_text())
    assert [part["versions"]["numpy"] == "1.0" for part in merged["parts"]] == [False, True, False]
    assert "shard" not in merged
    assert merged["started"] == "2020-02-02T20:20:20"  # the earliest


def parts_with_own_code(tmp_path: Path, texts: tuple[str, str]) -> tuple[list[Path], list[str]]:
    """Two parts of a sweep with an environment that has another folder, and a text, for each."""
    made_parts, names = [], []
    for part, text in enumerate(texts, start=1):
        name = tmp_path / f"home{part}" / "merged_point.py"
        name.parent.mkdir()
        name.write_text(text)
        names.append(f"{name}:PointMass")
        groups = build_groups("smoke", {**OPTIONS, "env": [names[-1]]})
        name_now(names[-1])
        load_named("env", names[-1])
        made_parts.append(train(tmp_path / f"own{part}", groups, part, 2, env=names[-1]))
    return made_parts, names


def test_a_file_that_lay_elsewhere_for_each_part_has_one_name_in_the_whole(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = POINT_MASS_FILE.read_text()
    own, (name, other) = parts_with_own_code(tmp_path, (text, text))
    shutil.rmtree(Path(other).parent)  # of another machine
    assert run(*own, "--out", tmp_path / "out") == 0
    assert "bits may differ" not in capsys.readouterr().err
    groups = RunDirectory.open(tmp_path / "out").config.groups()
    assert {one.values["env"] for group in groups for one in group.runs} == {name}
    assert {entry["env"] for entry in rows(tmp_path / "out")} == {name}
    merged = json.loads((tmp_path / "out" / "config.json").read_text())
    folders = [Path(path).parent for part in merged["parts"] for path in part["files"]]
    assert folders == [Path(name).parent, Path(other).parent]
    assert [*merged["files"]] == [name.partition(":")[0]]


def test_the_whole_knows_what_each_part_ran_and_parts_do_not_differ_by_that(
    parts: list[Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    ran = {1: {"/there/my.py": "ab"}, 2: {"/there/my.py": "ab", "/there/other.py": "cd"}, 0: {}}
    hosted = {0: {}, 1: {"numpy of gymnasium:x": "2.0"}, 2: {}}
    for number, part in enumerate(parts):
        config = json.loads((part / "config.json").read_text())
        config |= {"files": ran[number], "hosted": hosted[number]}
        if number == 1:
            config["variables"] |= {"CGM_JAX_GYMNASIUM_PYTHON": "python"}
        (part / "config.json").write_text(json.dumps(config))
    assert run(*parts, "--out", tmp_path / "out") == 0
    assert "bits may differ" not in capsys.readouterr().err
    merged = json.loads((tmp_path / "out/config.json").read_text())
    assert merged["files"] == ran[2]
    assert merged["hosted"] == hosted[1]
    assert merged["variables"]["CGM_JAX_GYMNASIUM_PYTHON"] == "python"
    other = json.loads((parts[0] / "config.json").read_text())
    other["hosted"] = hosted[1]  # with the interpreter of its own
    (parts[0] / "config.json").write_text(json.dumps(other))
    assert run(*parts, "--out", tmp_path / "hosted") == 0
    assert "parts differ in variables\n" in capsys.readouterr().err
    config = json.loads((parts[2] / "config.json").read_text())
    config["variables"] = {"JAX_ENABLE_X64": "1"}  # which changes bits wherever it is
    (parts[2] / "config.json").write_text(json.dumps(config))
    assert run(*parts, "--out", tmp_path / "again") == 0
    assert "parts differ in variables\n" in capsys.readouterr().err
    merged = json.loads((tmp_path / "again/config.json").read_text())
    assert "JAX_ENABLE_X64" not in merged["variables"]  # nor was it for all


def test_a_setting_that_the_sweep_does_not_vary_is_the_same_in_all_parts(
    parts: list[Path], tmp_path: Path
) -> None:
    config = json.loads((parts[2] / "config.json").read_text())
    config["groups"][0]["runs"][0]["discount"] = 0.9  # as a version with another default has it
    (parts[2] / "config.json").write_text(json.dumps(config))
    line = f"^discount: {parts[2]} was trained with 0.9, but {parts[0]} with 0.98$"
    with pytest.raises(SettingError, match=line):
        run(*parts, "--out", tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_a_checkpoint_of_an_older_format_is_not_said_to_be_of_this_one(
    parts: list[Path], tmp_path: Path
) -> None:
    for path in (parts[0] / "checkpoints").glob("*.json"):
        path.write_text(json.dumps(json.loads(path.read_text()) | {"format": 2}))
    assert run(*parts, "--out", tmp_path / "out") == 0
    found = finished_checkpoints(tmp_path / "out/checkpoints")
    assert [format_of(path) for path in found] == [2, FORMAT, FORMAT, FORMAT]


def test_other_bytes_in_a_file_of_the_same_name_are_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = POINT_MASS_FILE.read_text()
    own, _ = parts_with_own_code(tmp_path, (text, f"{text}# edited\n"))
    assert run(*own, "--out", tmp_path / "out") == 0
    assert "bits may differ: parts differ in files\n" in capsys.readouterr().err


def test_runs_that_diverged_are_told_as_one_sweep_would(tmp_path: Path) -> None:
    groups = whole()
    bad = train(tmp_path / "a", groups, 1, 2, failure="critic", failed_epoch=1)
    assert run(bad, train(tmp_path / "b", groups, 2, 2), "--out", tmp_path / "out") == 3


def test_a_torn_config_comes_back_from_a_checkpoint(
    parts: list[Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    config = (parts[1] / "config.json").read_bytes()
    (parts[1] / "config.json").write_bytes(config[:50])
    assert run(*parts, "--out", tmp_path / "out") == 0
    assert f"{parts[1] / 'config.json'} was damaged" in capsys.readouterr().err
    assert (parts[1] / "config.json").read_bytes() == config


def test_a_merge_that_was_killed_leaves_nothing_in_the_way(
    parts: list[Path], tmp_path: Path
) -> None:
    rest = tmp_path / ".out.merging" / "policies"
    rest.mkdir(parents=True)
    (rest / "rest.npz").write_text("of another sweep")
    (rest.parent / "start.npz").write_text("of another sweep")
    assert run(*parts, "--out", tmp_path / "out") == 0
    assert not (tmp_path / "out/start.npz").exists()
    assert not (tmp_path / "out/policies/rest.npz").exists()
    assert not rest.exists()
