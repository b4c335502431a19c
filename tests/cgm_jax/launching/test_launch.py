"""The command: what it refuses, what it takes for granted, and a whole launch on this machine."""

import errno
import importlib.util
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from cgm_jax import launch as program
from cgm_jax.config.fields import SettingError
from cgm_jax.host import memory, session
from cgm_jax.launching import check, local, ray, slurm
from cgm_jax.launching.check import check_sweep
from cgm_jax.launching.directory import Launch, Resources, read_launch
from cgm_jax.machine.allotment import MEMORY_VARIABLE
from cgm_jax.storage import run_directory
from cgm_jax.storage.lock import InUseError, locked
from tests.cgm_jax.host.in_process import outcome
from tests.cgm_jax.launching.launches import (
    SMOKE,
    assert_as_if_never_disturbed,
    attempts,
    begun,
    launch,
    trainer,
    uninterrupted,
    wait_for_checkpoint,
    wait_until,
)
from tests.cgm_jax.refusing import refusing
from tests.cgm_jax.sweeps import POINT_MASS, rows


@pytest.mark.parametrize(
    ("words", "line"),
    [
        (["--on", "local", *SMOKE], "jobs: say how many parts"),
        (["--jobs", "0", *SMOKE], r"jobs: 0 is not within \[1, "),
        (["--jobs", "2", "--cores", "0", *SMOKE], "cores: 0 is not within"),
        (["--jobs", "2", "--cores", "9999", *SMOKE], "cores: 9999 are more than the"),
        (["--jobs", "2", "--gpus", "1", *SMOKE], "gpus: 1 are more than the 0 found here"),
        (["--jobs", "2", *SMOKE, "--kappa", "-1"], "kappa: -1"),
        (["--jobs", "2", *SMOKE, "--shard", "1/2"], "shard: goes before --, or is the launch's"),
        (["--jobs", "2", *SMOKE, "--out", "x"], "out: goes before --"),
        (["--jobs", "2", "--", "--preset", "none"], "preset: unknown preset 'none'"),
        (["--jobs", "2", *SMOKE, "--checkpoint-seconds", "-1"], "checkpoint_seconds: -1"),
        (["--jobs", "2", *SMOKE, "--env", "none.py:X"], "env: .*none.py:X' is not FILE.py:NAME"),
        (["--resume", "none"], "resume: there is no directory none"),
        (["--resume", "none", "--jobs", "2"], "resume: a launch resumes as it was begun"),
        (["--on", "ray", "--jobs", "2", *SMOKE], r"on: ray needs Ray, .*'\.\[ray\]'$"),
        (["--jobs", "2", *SMOKE[1:]], "^preset: is an option of the sweep; those follow after --$"),
        (["--jobs", "2", "--from", "x", *SMOKE], "^from: is an option of the sweep; those follow"),
        (["--jobs", "2", "--minutes", "3", *SMOKE], "^minutes: goes with --on slurm$"),
        (["--jobs", "2", "--sbatch", "a=b", *SMOKE], "^sbatch: goes with --on slurm$"),
        (
            ["--on", "slurm", "--jobs", "2", "--address", "a", *SMOKE],
            "^address: goes with --on ray$",
        ),
        (["--on", "slurm", "--jobs", "2", *SMOKE], r"on: slurm needs .*'\.\[slurm\]'$"),
    ],
)
def test_bad_input_is_refused_before_anything_is_made(
    folder: Path, monkeypatch: pytest.MonkeyPatch, words: list[str], line: str
) -> None:
    monkeypatch.setattr(local, "visible_gpus", list)
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(SettingError, match=line):
        program.main(words)
    assert not list(folder.iterdir())


@pytest.fixture
def checked_here(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    """Sweeps are checked in this process, and in the memory that a part gets, all of it free."""

    def run(command: list[str], *, env: Mapping[str, str], **more: Any) -> Any:
        assert command[:3] == [sys.executable, "-m", check.PROGRAM]
        with monkeypatch.context() as patch:
            patch.setattr(sys, "argv", command[2:])
            patch.setattr(memory, "free_memory", lambda: int(env[MEMORY_VARIABLE]) * 2**20)
            code, _, errors = outcome(lambda _: check.main(), [], capsys)
        return SimpleNamespace(returncode=code, stderr=errors)

    started = SimpleNamespace(run=run, TimeoutExpired=subprocess.TimeoutExpired)
    monkeypatch.setattr(check, "subprocess", started)


@pytest.mark.parametrize(
    ("words", "line"),
    [
        (["--devices", "300"], "devices: 300, but the most on this cpu are 256$"),
        (["--environments", "100000"], "environments: one run takes .* of memory, and "),
        (["--env", "nosuch"], "env: unknown environment 'nosuch'; choose from "),
        (["--track", "nosuch"], "track: unknown track 'nosuch'; choose from "),
    ],
)
def test_what_parts_would_refuse_is_refused_before_anything_is_made(
    folder: Path, checked_here: None, words: list[str], line: str
) -> None:
    with pytest.raises(SettingError, match=f"^{line}"):
        program.main(["--jobs", "2", "--memory", "2", "--out", "out", *SMOKE, *words])
    assert not list(folder.iterdir())


def test_what_depends_on_the_machine_is_not_checked_where_others_train(
    checked_here: None, capsys: pytest.CaptureFixture[str]
) -> None:
    words = [*SMOKE[1:], "--devices", "300", "--environments", "1000000"]
    check_sweep(words, None)
    assert capsys.readouterr().err == ""  # not even that it could not be checked
    with pytest.raises(SettingError, match=r"^env: unknown environment 'nosuch'"):
        check_sweep([*words, "--env", "nosuch"], None)


def test_a_part_is_checked_with_the_memory_that_it_gets(folder: Path) -> None:
    words = ["--jobs", "2", "--memory", "0.5", "--out", "out", *SMOKE]
    with pytest.raises(SettingError, match=r"^memory: one run takes .*, and [0-9.]+ MiB are free$"):
        program.main(words)
    assert not list(folder.iterdir())


def test_what_cannot_be_checked_is_launched(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(check, "PROGRAM", "no.such.module")
    check_sweep(SMOKE[1:], None)
    assert capsys.readouterr().err == "not checked beforehand: exit code 1\n"
    monkeypatch.setattr(check, "PATIENCE_SECONDS", 0.01)
    check_sweep(SMOKE[1:], None)
    assert capsys.readouterr().err == "not checked beforehand: it takes over 0 s\n"


def test_a_launch_is_checked_when_it_is_new(
    folder: Path, planned: list[Launch], monkeypatch: pytest.MonkeyPatch
) -> None:
    checked = []
    monkeypatch.setattr(local, "visible_gpus", list)
    monkeypatch.setattr(program, "check_sweep", lambda words, part: checked.append((words, part)))
    words = ["--jobs", "2", "--out", "out", *SMOKE]
    for again in (words, words, ["--resume", "out"]):
        assert program.main(again) == 0
    ((_, part),) = checked
    assert len(planned) == 3
    assert set(part) == {MEMORY_VARIABLE}  # here, as one of two parts


def test_unknown_options_end_with_one_line(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for words in (["--jobz", "2"], ["--on", "pbs"], ["--jobs", "2", "--", "--kapa", "1"]):
        with pytest.raises(SystemExit) as end:
            program.main(words)
        assert end.value.code == 2
        assert len(capsys.readouterr().err.splitlines()) == 1
    assert not list(folder.iterdir())


def test_a_launch_is_recorded_so_that_it_can_be_resumed_elsewhere(
    folder: Path, planned: list[Launch], monkeypatch: pytest.MonkeyPatch
) -> None:
    shutil.copy(POINT_MASS.partition(":")[0], "launched_point.py")
    words = [*SMOKE, "--env", "launched_point.py:PointMass", "--seeds", "3"]
    assert program.main(["--jobs", "99", "--cores", "1", "--out", "out", *words]) == 0
    (folder / "elsewhere").mkdir()
    monkeypatch.chdir("elsewhere")
    assert program.main(["--resume", "../out"]) == 0
    first, again = planned
    assert first.parts == 6  # one for each run, of c_g 0.1, kappa 4 and 32, three seeds
    assert first == again == read_launch(folder / "out")
    own = f"{folder}/launched_point.py:PointMass"
    assert again.sweep == ("--preset", "smoke", "--env", own, "--seeds", "3")
    command = again.command(2)
    assert command[:3] == [sys.executable, "-m", "cgm_jax.sweep"]
    assert command[-6:-4] == ["--checkpoint-seconds", "60"]
    assert command[-4:] == ["--shard", "2/6", "--out", str(folder / "out/parts/2")]
    # Other resources may be given then; another sweep may not.
    assert program.main(["--resume", "../out", "--on", "local", "--memory", "2"]) == 0
    assert planned[-1].resources == Resources(cores=1, memory=2.0)
    with pytest.raises(SettingError, match="resumes as it was begun, without seeds"):
        program.main(["--resume", "../out", "--", "--seeds", "2"])
    with pytest.raises(SettingError, match="already holds a launch of another sweep"):
        program.main(["--jobs", "2", "--out", "../out", *SMOKE])
    monkeypatch.chdir(folder)
    assert program.main(["--jobs", "6", "--out", "out", *words]) == 0  # the same command again


REFUSED_TO_RESUME = [
    (["--csv"], "resume: a launch resumes as it was begun, without csv$"),
    (["--devices", "all"], "resume: .* without devices$"),  # though that is the default
    (["--checkpoint-seconds", "5"], "resume: .* without checkpoint_seconds$"),
    (["--checkpoint_seconds=5"], "resume: .* without checkpoint_seconds$"),
    (["--env", "point", "--dry-run"], "resume: .* without dry_run$"),
    (["--config", "a.toml"], "resume: .* without config$"),
    (["--from", "run"], "resume: .* without from$"),
    (["--set", "gain=1"], "resume: .* without set$"),
    (["--kappa", "4"], "resume: .* without kappa$"),
    (["--preset", "smoke"], "resume: .* without preset$"),
    (["--out", "x"], "resume: .* without out$"),
    (["--track", "wandb"], "track: .*/out was launched with tensorboard$"),
    (["--env", "push"], "env: .*/out was launched with reach, not push$"),
    (["--agent", "ddpg", "sac"], "agent: .*/out was launched with ddpg, not sac$"),
]


def test_a_launch_resumes_as_it_was_begun(folder: Path, planned: list[Launch]) -> None:
    sweep = ["--preset", "smoke", "--env", "reach", "--track", "tensorboard"]
    assert program.main(["--jobs", "2", "--out", "out", "--", *sweep]) == 0
    for words, line in REFUSED_TO_RESUME:
        with pytest.raises(SettingError, match=f"^{line}"):
            program.main(["--resume", "out", "--", *words])
        assert len(planned) == 1, words
    same = ["--env", "reach", "--agent", "ddpg", "--track", "tensorboard"]
    assert program.main(["--resume", "out", "--", *same]) == 0
    assert planned[1] == planned[0]


@pytest.mark.parametrize("name", ["config.json", "metrics.jsonl"])
def test_a_sweeps_directory_is_refused_before_the_sweep_is_checked(
    name: str, folder: Path, planned: list[Launch], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(program, "check_sweep", lambda *_: pytest.fail("it was checked"))
    (folder / "out").mkdir()
    (folder / "out" / name).write_text("theirs")
    with pytest.raises(SettingError, match=r"^out: .*/out already holds a sweep; name another"):
        program.main(["--jobs", "2", "--out", "out", *SMOKE])
    assert [path.name for path in (folder / "out").iterdir()] == [name]
    assert not planned
    (folder / name).write_text("theirs")  # without --out the working directory may hold anything
    monkeypatch.setattr(program, "check_sweep", lambda *_: None)
    assert program.main(["--jobs", "2", *SMOKE]) == 0


@pytest.mark.parametrize("named", [True, False])
def test_a_full_disk_ends_a_launch_that_begins_with_74(
    named: bool,
    folder: Path,
    planned: list[Launch],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    full = refusing(errno.ENOSPC)

    words = ["--jobs", "2", *(["--out", "out"] if named else []), *SMOKE]
    out, where = folder / "out", (run_directory, "locked") if named else (session, "_made")
    with monkeypatch.context() as patch:
        patch.setattr(*where, full)
        assert program.main(words) == 74
    place = out if named else "runs"
    error, advice = capsys.readouterr().err.splitlines()
    assert error == f"error: cannot write to {place}: No space left on device"
    assert advice == "nothing was begun"
    monkeypatch.setattr(Launch, "write", full)
    assert program.main(words) == 74
    assert not planned


def test_a_full_disk_ends_a_launch_that_goes_on_with_74(
    folder: Path,
    planned: list[Launch],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    refused = refusing(errno.EACCES)

    assert program.main(["--jobs", "2", "--out", "out", *SMOKE]) == 0
    monkeypatch.setattr(run_directory, "locked", refused)
    assert program.main(["--resume", "out"]) == 74
    error, advice = capsys.readouterr().err.splitlines()[-2:]
    assert error == f"error: cannot write to {folder / 'out'}: Permission denied"
    assert advice.endswith(f"cgm_jax.launch --resume {folder / 'out'}")
    assert len(planned) == 1


def test_one_launcher_is_in_a_directory_at_a_time(folder: Path, planned: list[Launch]) -> None:
    (folder / "out").mkdir()
    with locked(folder / "out"), pytest.raises(InUseError):
        program.main(["--jobs", "2", "--out", "out", *SMOKE])
    assert not planned


def test_ray_and_slurm_are_not_imported_without_need() -> None:
    assert "submitit" not in vars(slurm)
    assert "ray" not in vars(ray)


@pytest.mark.slow
def test_a_killed_trainer_and_a_stopped_launcher_lose_nothing(tmp_path: Path) -> None:
    whole, out = uninterrupted(tmp_path / "whole"), tmp_path / "out"
    command = launch("local", out)
    with begun(command) as process:
        killed = wait_for_checkpoint(process, out, 1)
        os.kill(wait_until(process, lambda: trainer(out, 1), "a trainer"), signal.SIGKILL)
        wait_for_checkpoint(process, out, 1, after=killed + 5)
        process.send_signal(signal.SIGTERM)
        assert process.wait(60) == 75
    stopped = attempts(out, 1)
    assert [code for _, code in stopped] == [-9, 75]
    assert not (out / "config.json").exists()
    result = subprocess.run(
        command, capture_output=True, text=True, check=False
    )  # the same command
    assert result.returncode == 0, result.stderr
    starts = [start for start, _ in attempts(out, 1)]
    assert len(starts) == 3
    assert 0 == starts[0] < killed <= starts[1] < starts[2]
    assert len(result.stdout.splitlines()) == 4 + 1
    assert_as_if_never_disturbed(whole, out)
    assert rows(out)
    again = subprocess.run(
        command, capture_output=True, text=True, check=False
    )  # there is nothing to do
    assert (again.returncode, again.stdout) == (0, result.stdout)
