"""Parts of a sweep, made up, put together; real ones are in launching/test_local.py."""

import csv
import errno
import hashlib
import io
import json
import re
import shlex
import shutil
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cgm_jax import merge
from cgm_jax.config.fields import SettingError
from cgm_jax.config.grid import Group, Run, build_groups
from cgm_jax.config.named import load_named, name_now
from cgm_jax.config.shards import cut
from cgm_jax.host.settings_file import read_settings_file
from cgm_jax.results import figures, merging
from cgm_jax.storage import run_directory
from cgm_jax.storage.arrays import write_arrays
from cgm_jax.storage.checkpoints import damage, finished_checkpoints, write_manifest
from cgm_jax.storage.metrics import Row, to_lines
from cgm_jax.storage.run_directory import RunDirectory
from tests.cgm_jax.archives import spoil
from tests.cgm_jax.refusing import refusing
from tests.cgm_jax.results.figures import made
from tests.cgm_jax.sweeps import POINT_MASS, rows

POINT_MASS_FILE = Path(POINT_MASS.partition(":")[0])
EPOCHS = 2
OPTIONS = {"curriculum": ["cgm", "full"], "kappa": [4.0], "seed": [0, 1, 2], "epochs": [EPOCHS]}


def whole() -> list[Group]:
    """Six runs of two programs."""
    return build_groups("smoke", OPTIONS)


def row(run: Run, epoch: int, **values: Any) -> Row:
    (made_up,) = made.run([0.5], curriculum=run.values["curriculum"])
    return {**made_up, "run": run.name, "epoch": epoch, "physics_warnings": 0, **values}


def train(
    path: Path,
    groups: list[Group],
    part: int,
    parts: int,
    *,
    until: int = EPOCHS,
    start: tuple[str, int] | None = None,
    **values: Any,
) -> Path:
    """Make the directory that training a part up to an epoch would leave.

    `start` is what it began from: what that was called, and what it held.
    """
    pieces, shard = cut(groups, part, parts)
    with RunDirectory.claimed(path, fresh=True) as directory:
        origin = None
        if start is not None:
            origin, number = start
            directory.write_start({"array": np.array(number)})
        directory.config.write(pieces, "smoke", "1 x cpu", shard=shard, origin=origin)
        all_rows = []
        for index, group in enumerate(pieces):
            own = [row(r, e, **values) for e in range(1, until + 1) for r in group.runs]
            checkpoint(path / "checkpoints", index, own, until, directory.config.read_bytes())
            all_rows += own
            for run in group.runs:
                directory.write_policy(run, {"part": np.array(part)})
                directory.write_improvement(run, 1, {"part": np.array(10 + part)})
        directory.replace_metrics(all_rows)
    return path


def checkpoint(folder: Path, index: int, own: list[Row], epoch: int, config: bytes) -> None:
    path = folder / f"group{index}_epoch{epoch:06d}_cycle000000.npz"
    arrays = {
        "position": np.array([epoch, 0]),
        "wall_s": np.array(1.0),
        "rows": np.frombuffer(to_lines(own).encode(), np.uint8),
    }
    with path.open("wb") as file:
        write_arrays(file, arrays.items())
    data = path.read_bytes()
    write_manifest(path, hashlib.sha256(data).hexdigest(), len(data), config)


@pytest.fixture
def parts(tmp_path: Path) -> list[Path]:
    groups = whole()
    return [train(tmp_path / f"part{part}", groups, part, 3) for part in (1, 2, 3)]


@pytest.fixture(autouse=True)
def no_figures(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(figures, "draw_figures", lambda _: None)


def run(*words: Any) -> int:
    return merge.main([str(word) for word in words])


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


def test_parts_that_began_from_something_else_are_refused(tmp_path: Path) -> None:
    first = train(tmp_path / "first", whole(), 1, 2, start=("/there", 7))
    for name, start, line in (
        ("nothing", None, "{second} was begun from nothing, but {first} from /there"),
        ("other", ("/elsewhere", 8), "{second} was begun from /elsewhere, but {first} from /there"),
        ("later", ("/there", 8), "{second} was begun from /there, another one, but {first} from"),
    ):
        second = train(tmp_path / name, whole(), 2, 2, start=start)
        line = line.format(first=first, second=second)
        told = refused(tmp_path, first, second, "--out", tmp_path / "out")
        assert told.startswith(f"from: {line}")
    (first / "start.npz").unlink()
    line = refused(tmp_path, first, second, "--out", tmp_path / "out")
    assert line.endswith(f"{first / 'start.npz'} is missing")


def test_a_full_disk_ends_a_merge_with_74_and_leaves_nothing(
    parts: list[Path],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    full = refusing(errno.ENOSPC)

    before = sorted(tmp_path.rglob("*"))
    for module, name in ((run_directory, "locked"), (merging, "write_manifest")):
        with monkeypatch.context() as patch:
            patch.setattr(module, name, full)
            assert run(*parts, "--out", tmp_path / "out") == 74
        line = f"error: cannot write to {tmp_path / 'out'}: No space left on device\n"
        assert capsys.readouterr().err == line
        assert sorted(tmp_path.rglob("*")) == before


def test_a_place_that_cannot_be_is_refused(parts: list[Path], tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    line = refused(tmp_path, *parts, "--out", tmp_path / "file" / "out")
    assert line == f"out: cannot write to {tmp_path / 'file' / 'out'}: Not a directory"


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


def refused(tmp_path: Path, *words: Any) -> str:
    """The line with which merging is refused; nothing may have been made."""
    before = sorted(tmp_path.rglob("*"))
    with pytest.raises(SettingError) as error:
        run(*words)
    assert sorted(tmp_path.rglob("*")) == before
    return str(error.value)


def test_what_is_not_all_parts_of_one_sweep_is_refused_by_name(
    parts: list[Path], tmp_path: Path
) -> None:
    out = ["--out", tmp_path / "out"]
    first, second, third = parts
    other = build_groups("smoke", {**OPTIONS, "kappa": [5.0]})
    foreign = train(tmp_path / "foreign", other, 3, 3)
    halves = train(tmp_path / "half", whole(), 2, 2)
    again = train(tmp_path / "again", whole(), 1, 3)
    short = train(tmp_path / "short", whole(), 3, 3, until=1)
    with RunDirectory.claimed(tmp_path / "alone", fresh=True) as directory:
        directory.config.write(whole(), "smoke", "1 x cpu")
    for words, line in {
        (first, third): "part 2 of 3 missing: train with --shard 2/3",
        (third,): "parts 1, 2 of 3 missing",
        (first, second, again): f"part 1 is given twice: {first} and {again}",
        (first, first, second, third): f"part 1 is given twice: {first} and {first}",
        (first, second, foreign): f"{foreign} is part of another sweep than {first}",
        (first, halves): f"{halves} is a part of 2, but {first} is a part of 3",
        (first, second, short): f"{short} is not finished (epoch 1 of 2); resume it: ",
        (first, tmp_path / "alone"): f"{tmp_path / 'alone'} is no part of a sweep",
        (first, tmp_path): f"{tmp_path} holds no sweep",
        (): "directories: name those of all parts",
    }.items():
        assert line in refused(tmp_path, *words, *out)


def test_an_out_that_exists_is_left_alone(parts: list[Path], tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    assert "exists already" in refused(tmp_path, *parts, "--out", tmp_path / "out")
    assert "out: name the directory" in refused(tmp_path, *parts)


def test_damaged_and_foreign_checkpoints_are_refused(parts: list[Path], tmp_path: Path) -> None:
    (last,) = finished_checkpoints(parts[0] / "checkpoints")
    data = last.read_bytes()
    last.write_bytes(data[:-1] + b"x")
    line = refused(tmp_path, *parts, "--out", tmp_path / "out")
    assert re.search(r"is damaged \(its checksum differs\); resume it", line)
    own = [row(whole()[0].runs[2], epoch) for epoch in (1, 2)]
    checkpoint(last.parent, 0, own, EPOCHS, b"{}")
    line = refused(tmp_path, *parts, "--out", tmp_path / "out")
    assert line.endswith(
        "holds rows of other runs: they are not one for each of its runs and epochs"
    )


@pytest.mark.parametrize(
    ("array", "content", "line"),
    [
        ("rows", b"{}\n", "holds rows of other runs: 'run'"),
        ("rows", b"", "holds rows of other runs: they are not one for each"),
        ("rows", b"\xff\n", "is no checkpoint: "),
        ("position", np.array([10**17, 0]), "holds rows of other runs: they are not one for each"),
        ("position", np.array(1), "is no checkpoint: "),
        ("position", np.array(["x", "y"]), "is no checkpoint: "),
    ],
)
def test_forged_checkpoints_are_refused(
    array: str, content: Any, line: str, parts: list[Path], tmp_path: Path
) -> None:
    (last,) = finished_checkpoints(parts[0] / "checkpoints")
    with np.load(last) as file:
        arrays = dict(file)
    arrays[array] = np.frombuffer(content, np.uint8) if isinstance(content, bytes) else content
    with last.open("wb") as file:
        write_arrays(file, arrays.items())
    data = last.read_bytes()
    write_manifest(last, hashlib.sha256(data).hexdigest(), len(data), b"{}")
    assert f"{last} {line}" in refused(tmp_path, *parts, "--out", tmp_path / "out")


def test_a_checkpoint_with_damaged_bytes_under_the_right_checksum_is_refused(
    parts: list[Path], tmp_path: Path
) -> None:
    (last,) = finished_checkpoints(parts[0] / "checkpoints")
    with np.load(last) as file:
        arrays = {**file, "rows": np.zeros(10_000, np.uint8)}
    with last.open("wb") as file:
        write_arrays(file, arrays.items())
    data = last.read_bytes()
    write_manifest(last, hashlib.sha256(data).hexdigest(), len(data), b"{}")
    spoil(last, "rows")
    assert damage(last) is None
    line = refused(tmp_path, *parts, "--out", tmp_path / "out")
    assert f"{last} is no file of arrays (Bad CRC-32" in line


def test_what_is_no_archive_and_what_claims_terabytes_are_refused(
    parts: list[Path], tmp_path: Path
) -> None:
    (last,) = finished_checkpoints(parts[0] / "checkpoints")
    bomb = io.BytesIO()
    header = {"descr": "|u1", "fortran_order": False, "shape": (10**13,)}
    np.lib.format.write_array_header_1_0(bomb, header)
    for content in (None, bomb.getvalue()):
        if content is None:
            last.write_bytes(b"no archive")
        else:
            with zipfile.ZipFile(last, "w") as archive:
                archive.writestr("position.npy", content)
        data = last.read_bytes()
        write_manifest(last, hashlib.sha256(data).hexdigest(), len(data), b"{}")
        line = refused(tmp_path, *parts, "--out", tmp_path / "out")
        assert f"{last} is no checkpoint: {last} is no file of arrays" in line


def test_the_printed_command_works_as_it_is_from_anywhere(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    short = train(Path("my part"), whole(), 1, 1, until=1)
    line = refused(tmp_path, short, "--out", tmp_path / "out")
    command = shlex.split(line.partition("resume it: ")[2])
    assert command[1:] == ["-m", "cgm_jax.sweep", "--resume", str(tmp_path / "my part")]


def test_a_torn_config_comes_back_from_a_checkpoint(
    parts: list[Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    config = (parts[1] / "config.json").read_bytes()
    (parts[1] / "config.json").write_bytes(config[:50])
    assert run(*parts, "--out", tmp_path / "out") == 0
    assert f"{parts[1] / 'config.json'} was damaged" in capsys.readouterr().err
    assert (parts[1] / "config.json").read_bytes() == config


def test_a_part_without_a_policy_is_refused_by_name(parts: list[Path], tmp_path: Path) -> None:
    gone = next((parts[1] / "policies").glob("*.npz"))
    gone.unlink()
    line = refused(tmp_path, *parts, "--out", tmp_path / "out")
    assert line.startswith(f"{gone} is missing; resume it: ")


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
