"""What is not all parts of one sweep, whole and undamaged, is not merged."""

import errno
import hashlib
import io
import re
import shlex
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cgm_jax.config.grid import build_groups
from cgm_jax.results import merging
from cgm_jax.results import parts as parts_module
from cgm_jax.storage import config_file
from cgm_jax.storage.arrays import write_arrays
from cgm_jax.storage.checkpoints import damage, finished_checkpoints, write_manifest
from cgm_jax.storage.run_directory import RunDirectory
from tests.cgm_jax.archives import spoil
from tests.cgm_jax.refusing import refusing
from tests.cgm_jax.results.merging.made_parts import (
    EPOCHS,
    OPTIONS,
    checkpoint,
    refused,
    row,
    run,
    train,
    whole,
)
from tests.cgm_jax.sweeps import rows


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


def test_a_place_that_cannot_be_is_refused(parts: list[Path], tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    line = refused(tmp_path, *parts, "--out", tmp_path / "file" / "out")
    assert line == f"out: cannot write to {tmp_path / 'file' / 'out'}: Not a directory"


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
    assert line.endswith("holds rows of other runs: there is not one row per run and epoch")


@pytest.mark.parametrize(
    ("array", "content", "line"),
    [
        ("rows", b"{}\n", "holds rows of other runs: 'run'"),
        ("rows", b"", "holds rows of other runs: there is not one row per"),
        ("rows", b"\xff\n", "is no checkpoint: "),
        ("position", np.array([10**17, 0]), "holds rows of other runs: there is not one row per"),
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


def test_a_part_without_a_policy_is_refused_by_name(parts: list[Path], tmp_path: Path) -> None:
    gone = next((parts[1] / "policies").glob("*.npz"))
    gone.unlink()
    line = refused(tmp_path, *parts, "--out", tmp_path / "out")
    assert line.startswith(f"{gone} is missing; resume it: ")


@pytest.mark.parametrize(
    ("module", "name"),
    [(parts_module, "damage"), (config_file, "read_json"), (parts_module, "_digest")],
)
def test_a_part_that_cannot_be_read_just_now_is_no_bad_input(
    module: Any,
    name: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    part = train(tmp_path / "part", whole(), 1, 1, start=("there", 1))
    monkeypatch.setattr(module, name, refusing(errno.ESTALE))
    assert run(part, "--out", tmp_path / "out") == 74
    line = capsys.readouterr().err
    assert line.startswith(f"error: cannot read {part}")
    assert line.endswith(": Stale file handle\n")
    assert not (tmp_path / "out").exists()


def test_a_merge_that_is_killed_leaves_no_sweep_however_far_it_came(
    parts: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write, written = merging.write_manifest_again, []

    def killed(*arguments: Any) -> None:
        if len(written) == 3:  # of four
            raise KeyboardInterrupt
        written.append(write(*arguments))

    monkeypatch.setattr(merging, "write_manifest_again", killed)
    with pytest.raises(KeyboardInterrupt):
        run(*parts, "--out", tmp_path / "out")
    making = RunDirectory(tmp_path / ".out.merging")
    assert len(finished_checkpoints(making.path / "checkpoints")) == 3
    assert making.config.restore() is None
    assert len(rows(making.path)) == len(list((making.path / "policies").glob("*.npz"))) * EPOCHS
