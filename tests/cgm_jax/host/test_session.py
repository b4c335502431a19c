"""Whole sweeps on the point mass, in this process, through every fault that can be staged.

The programs compile once for all tests; processes of their own are in test_resume.py.
"""

import asyncio
import builtins
import contextlib
import csv
import dataclasses
import errno
import functools
import hashlib
import io
import json
import os
import re
import resource
import shutil
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax
import mujoco
import numpy as np
import pytest
from brax.envs.base import State
from jax.experimental.buffer_callback import buffer_callback

from cgm_jax import sweep
from cgm_jax.config.fields import SettingError
from cgm_jax.config.grid import Group, build_groups, run_of
from cgm_jax.config.settings import Settings
from cgm_jax.host import dry_run, recorder, runner, session
from cgm_jax.host.checkpoint import TrainingProgress
from cgm_jax.results import figures
from cgm_jax.storage.checkpoints import finished_checkpoints
from cgm_jax.storage.lock import InUseError, locked
from cgm_jax.storage.run_directory import RunDirectory
from tests.cgm_jax.sweeps import POINT_MASS, assert_same_results, final_state, rows
from tests.examples.point_mass import PointMass

EPOCHS, RUNS = 4, 2
OPTIONS = ["--preset", "smoke", "--env", POINT_MASS, "--epochs", str(EPOCHS)]
DRAW_FIGURES = figures.draw_figures
ALWAYS = ["--checkpoint-seconds", "0"]


@pytest.fixture(autouse=True)
def fast(
    monkeypatch: pytest.MonkeyPatch, trainers: Callable[..., Any], programs: Callable[..., Any]
) -> None:
    monkeypatch.setattr(figures, "draw_figures", lambda _: None)
    monkeypatch.setattr(runner, "make_environment", lambda _: PointMass())
    monkeypatch.setattr(runner, "make_trainer", trainers)
    monkeypatch.setattr(runner, "make_programs", programs)
    # The default would end pytest itself, were the machine slow.
    patient = functools.partial(session.Interruption, patience=300.0)
    monkeypatch.setattr(session, "Interruption", patient)


@pytest.fixture(scope="module")
def trainers() -> Callable[..., Any]:
    """Trainers that are made once, so that their programs are too."""
    return functools.cache(runner.make_trainer)


@pytest.fixture(scope="module")
def programs() -> Callable[..., Any]:
    made: dict[Any, Any] = {}
    make = runner.make_programs

    def make_once(trainer: Any, _: Any) -> Any:  # whatever only the host looks at
        env, settings = trainer.setup.env, trainer.setup.settings
        key = (env, dataclasses.replace(settings, epochs=EPOCHS, leave_at=None))
        return made.setdefault(key, make(trainer))._replace(trainer=trainer)

    return make_once


def train(out: Path, *options: str) -> int:
    return sweep.main([*OPTIONS, "--out", str(out), *options])


@pytest.fixture(scope="module")
def whole(
    tmp_path_factory: pytest.TempPathFactory,
    trainers: Callable[..., Any],
    programs: Callable[..., Any],
) -> Path:
    """A sweep that nothing has disturbed."""
    out = tmp_path_factory.mktemp("whole") / "out"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(runner, "make_environment", lambda _: PointMass())
        patch.setattr(runner, "make_trainer", trainers)
        patch.setattr(runner, "make_programs", programs)
        assert train(out) == 0
    return out


def at_epoch(monkeypatch: pytest.MonkeyPatch, epoch: int, action: Callable[[], Any]) -> None:
    """Do something once, in the middle of training, before the rows of `epoch` are written."""
    record = recorder.Recorder.record_epoch

    def recording(self: Any, training: Any, metrics: Any) -> Any:
        if training.epoch == epoch:
            action()
        return record(self, training, metrics)

    monkeypatch.setattr(recorder.Recorder, "record_epoch", recording)


def stop_at_epoch(monkeypatch: pytest.MonkeyPatch, epoch: int, out: Path, *options: str) -> None:
    with monkeypatch.context() as patch:
        at_epoch(patch, epoch, lambda: os.kill(os.getpid(), signal.SIGTERM))
        assert train(out, *options) == 75


def test_a_cycle_for_which_a_signal_cannot_wait_begins_with_nothing_to_lose(
    whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    listening, begun = [], []
    listen, train_chunk = session.Interruption, runner._train_chunk

    def remembered(**options: Any) -> Any:
        listening.append(listen(**options))
        return listening[-1]

    def chunk(job: runner.Job, training: TrainingProgress, *rest: Any) -> None:
        saved = finished_checkpoints(tmp_path / "out" / "checkpoints", 0)[-1:]
        stem = f"group0_epoch{training.epoch:06d}_cycle{training.cycle:06d}"
        begun.append((listening[0].expendable, [path.stem for path in saved] == [stem]))
        train_chunk(job, training, *rest)

    monkeypatch.setattr(session, "Interruption", remembered)
    monkeypatch.setattr(runner, "_train_chunk", chunk)
    monkeypatch.setattr(runner, "PATIENCE_SECONDS", 0.0)  # as if every cycle took longer
    assert train(tmp_path / "out") == 0
    # The first compiles, and only the second tells how long a cycle takes.
    assert begun[:2] == [(True, False), (False, False)]
    assert begun[2:] == [(True, True)] * (len(begun) - 2)
    assert len(begun) > EPOCHS
    assert_same_results(whole, tmp_path / "out")


def test_the_same_command_resumes_and_a_finished_sweep_stays_as_it_is(
    whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    monkeypatch.setattr(figures, "draw_figures", DRAW_FIGURES)
    stop_at_epoch(monkeypatch, 2, out)
    monkeypatch.setattr(figures, "draw_figures", lambda _: None)
    command = f"{sys.executable} -m cgm_jax.sweep --resume {out}"
    assert f"stopped; to resume: {command}" in capsys.readouterr().err
    assert len(rows(out)) == 2 * RUNS
    assert (out / "figures" / "learning_curves.png").is_file()
    assert train(out) == 0
    assert "resuming where it was stopped" in capsys.readouterr().err
    assert_same_results(whole, out)
    before = {path: path.stat().st_mtime_ns for path in (out / "checkpoints").iterdir()}
    assert sweep.main(["--resume", str(out)]) == 0
    assert {path: path.stat().st_mtime_ns for path in (out / "checkpoints").iterdir()} == before
    assert_same_results(whole, out)


class CellOutput(io.StringIO):
    """Output as ipykernel replaces it: text without a file behind it, and no terminal."""

    encoding = "UTF-8"  # pyright: ignore[reportAssignmentType]

    def fileno(self) -> int:
        raise io.UnsupportedOperation("fileno")


def test_main_trains_in_a_thread_and_inside_a_running_event_loop(
    whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    codes: list[int] = []
    thread = threading.Thread(target=lambda: codes.append(train(tmp_path / "thread")))
    thread.start()
    thread.join()

    # As a notebook runs a cell: in its event loop, with an `get_ipython` among the builtins.
    monkeypatch.setattr(builtins, "get_ipython", object, raising=False)
    outputs = {name: CellOutput() for name in ("stdout", "stderr")}
    handlers = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}

    async def cell() -> int:
        with monkeypatch.context() as notebook:
            for name, output in outputs.items():
                notebook.setattr(sys, name, output)
            return train(tmp_path / "notebook")

    assert [*codes, asyncio.run(cell())] == [0, 0]
    assert "Traceback" not in outputs["stderr"].getvalue()
    assert "%" in outputs["stdout"].getvalue()  # the summary
    assert {number: signal.getsignal(number) for number in handlers} == handlers
    assert_same_results(whole, tmp_path / "thread")
    assert_same_results(whole, tmp_path / "notebook")


def test_one_at_a_time_runs_leave_once_they_hold_the_success_and_stay_away(tmp_path: Path) -> None:
    out = tmp_path / "out"
    options = ["--side-by-side", "1", "--leave-at", "0"]  # a success that any run holds
    assert train(out, *options) == 0
    written = [(row["kappa"], row["epoch"]) for row in rows(out)]
    assert written == [(4.0, 1), (4.0, 2), (4.0, 3), (32.0, 1), (32.0, 2), (32.0, 3)]
    assert len(list((out / "policies").glob("*.npz"))) == RUNS
    assert train(out, *options) == 0
    assert [(row["kappa"], row["epoch"]) for row in rows(out)] == written


@pytest.mark.parametrize(
    ("first", "second", "finished"),
    [
        ([0.4, 0.5, 0.6], [0.9, 0.9, 0.0], True),  # means 0.5 and 0.6
        ([0.4, 0.5, 0.5], [0.9, 0.9, 0.9], False),  # all must hold it
        ([0.9, 0.9], [0.9, 0.9], False),  # not three evaluations yet
        ([0.0, 0.5, 0.5, 0.5], [0.0, 0.5, None, 1.0], True),  # only the last three count
    ],
)
def test_all_runs_side_by_side_must_hold_the_success(
    first: list[float], second: list[float | None], finished: bool
) -> None:
    settings = Settings(epochs=9, leave_at=0.5)
    values = dataclasses.asdict(settings)
    group = Group(settings, tuple(run_of(name, values)[1] for name in "ab"))
    both = [{"success_rate": r} for pair in zip(first, second, strict=True) for r in pair]
    state: Any = None
    training = TrainingProgress(state, epoch=len(first), rows=both)
    assert runner._is_finished(group, training) == finished
    training.cycle = 1  # in the middle of an epoch nothing is decided
    assert not runner._is_finished(group, training)


def test_wall_s_continues_over_interruptions_and_jumps_of_the_clock(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out, jumps = tmp_path / "out", iter([4e9, 0.0, -1e9] * 10_000)
    monkeypatch.setattr(time, "time", lambda: next(jumps))
    began = time.monotonic()
    stop_at_epoch(monkeypatch, 2, out)
    assert train(out) == 0
    lines = (out / "metrics.jsonl").read_text().splitlines()
    times = [json.loads(line)["wall_s"] for line in lines[::RUNS]]
    assert times == sorted(times)
    assert 0 < times[0] < times[-1] <= time.monotonic() - began


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

    def full(*_: Any) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with monkeypatch.context() as patch:
        patch.setattr(RunDirectory, "replace_config", full)
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


@dataclass(frozen=True)
class Breaking(PointMass):
    """The point mass on a physics engine that can raise, as MuJoCo does when it runs out."""

    def step(self, state: State, action: jax.Array) -> State:
        shape = jax.ShapeDtypeStruct(action.shape, action.dtype)
        call = buffer_callback(self._advance, shape, vmap_method="broadcast_all")
        return super().step(state, call(action))

    def _advance(self, _: Any, output: Any, action: Any) -> None:
        if broken:
            raise mujoco.FatalError(  # pyright: ignore
                "mj_stackAlloc: out of memory"
            )
        np.asarray(output)[...] = np.asarray(action)


broken = False


def test_a_mujoco_error_in_the_callback_ends_with_its_message_and_can_go_on(
    whole: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    out = tmp_path / "out"
    monkeypatch.setattr(runner, "make_environment", lambda _: Breaking())
    with monkeypatch.context() as patch:
        at_epoch(patch, 2, lambda: patch.setitem(globals(), "broken", True))
        assert train(out, *ALWAYS) == 1
        jax.effects_barrier()  # nothing is left to be raised at exit
    error, advice = capsys.readouterr().err.splitlines()[-2:]
    assert error.startswith('error: FatalError: mj_stackAlloc: out of memory (File "')
    assert error.endswith(", in _advance)")
    assert advice == f"to resume: {sys.executable} -m cgm_jax.sweep --resume {out}"
    assert train(out) == 0
    assert_same_results(whole, out)


def test_a_directory_in_use_is_refused_and_left_alone(whole: Path) -> None:
    before = {
        path: path.stat().st_mtime_ns
        for path in whole.rglob("*")
        if path.name not in ("lock", "holder")
    }
    with locked(whole), pytest.raises(InUseError, match=f"{whole} is in use by .*process"):
        train(whole)
    assert before == {path: path.stat().st_mtime_ns for path in before}


@pytest.mark.parametrize(
    ("options", "complaint"),
    [
        (["--epochs", "3"], "epochs 4, not 3$"),
        (["--epochs", "5"], "epochs 4, not 5; to train it for longer: .*--resume .* --epochs 5$"),
        (["--seed", "1"], "seed 0, not 1$"),
        (["--kappa", "32", "4"], "these values in another order$"),
        (["--kappa", "4", "--epochs", "5"], "epochs 4, not 5; kappa 4 32, not 4$"),
        (
            ["--agent", "sac", "--curriculum", "full"],
            "curriculum cgm, not full; agent ddpg, not sac; .*; and 1[0-9] more$",
        ),
        (["--hidden-layers", "32x32", "8"], "hidden_layers 32x32, not 32x32 8$"),
    ],
)
def test_another_sweep_in_the_same_directory_is_refused_with_what_differs(
    options: list[str], complaint: str, whole: Path
) -> None:
    with pytest.raises(SettingError, match=f"^out: {whole} already holds a sweep .*{complaint}"):
        train(whole, *options)


@pytest.mark.parametrize(
    ("options", "complaint"),
    [
        (
            ["--kappa", "4"],
            "kappa: .* was begun with 4 32, not 4; a sweep resumes as it was begun$",
        ),
        (["--seeds", "2"], "seed: .* was begun with 0, not 0 1; "),
        (["--target-noise", "0.1"], "target_noise: .* was begun with none, not 0.1; "),
        (["--epochs", "3"], "epochs: 3 are fewer than the 4 that .* has begun$"),
        (["--epochs", "0"], "epochs: 0 are fewer than the 4 "),
        (["--epochs", "5", "6"], "epochs: takes one value with --resume$"),
        (["--epochs", "1000000000"], "epochs: .* env_steps in all are more than can be counted$"),
    ],
)
def test_resuming_with_other_settings_is_refused_with_both_values(
    options: list[str], complaint: str, whole: Path
) -> None:
    before = (whole / "config.json").read_bytes()
    with pytest.raises(SettingError, match=f"^{complaint}"):
        sweep.main(["--resume", str(whole), *options])
    assert (whole / "config.json").read_bytes() == before


@pytest.mark.parametrize("stopped", [False, True])
def test_more_epochs_give_the_bits_of_a_sweep_that_was_asked_for_them_from_the_start(
    stopped: bool,
    whole: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    out = tmp_path / "out"
    if stopped:  # in its second epoch of three
        stop_at_epoch(monkeypatch, 2, out, "--epochs", "3", *ALWAYS)
    else:
        assert train(out, "--epochs", "2", "--csv") == 0
    before = 3 if stopped else 2
    capsys.readouterr()
    # Settings that are as they were may be given again.
    assert sweep.main(["--resume", str(out), "--epochs", "4", "--kappa", "4", "32"]) == 0
    assert f"4 epochs instead of {before}" in capsys.readouterr().err
    assert_same_results(whole, out)
    config = json.loads((out / "config.json").read_text())
    assert {run["epochs"] for group in config["groups"] for run in group["runs"]} == {4}
    assert config["resumed"][-1]["changed"] == [f"epochs {before} (now 4)"]
    assert train(out) == 0  # the same as a sweep of four epochs from now on
    assert (out / "metrics.csv").exists() is not stopped  # once asked for, it is kept up to date
    if not stopped:
        rates = [row["success_rate"] for row in rows(out)]
        assert [float(row["success_rate"]) for row in table(out)] == rates


@pytest.mark.parametrize("damage", ["array", "archive", "format"])
def test_a_checkpoint_that_is_refused_leaves_the_directory_as_it_is(
    damage: str, whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "out"
    shutil.copytree(whole, out)
    path = max((out / "checkpoints").glob("*.npz"))
    manifest = path.with_suffix(".json")
    if damage == "array":
        with np.load(path) as file:
            arrays = {name: file[name] for name in file.files}
        del arrays[".env_steps"]
        with path.open("wb") as file:
            np.savez(file, **arrays)
    elif damage == "archive":
        path.write_bytes(b"whole, but no archive")
    digest, size = hashlib.sha256(path.read_bytes()).hexdigest(), path.stat().st_size
    entry = json.loads(manifest.read_text()) | {"sha256": digest, "bytes": size}
    manifest.write_text(json.dumps(entry | ({"format": 99} if damage == "format" else {})))
    before = {one: one.read_bytes() for one in out.rglob("*") if one.is_file()}
    monkeypatch.setenv("JAX_OF_ANOTHER_DAY", "1")  # which may be the reason
    line = r"^resume: .*npz (is|holds) .*; it was begun with .*JAX_OF_ANOTHER_DAY none \(now 1\)"
    with pytest.raises(SettingError, match=line):
        sweep.main(["--resume", str(out), "--epochs", "9"])
    after = {one: one.read_bytes() for one in out.rglob("*") if one.is_file()}
    assert {one.name for one in after if after[one] != before.get(one)} <= {"holder"}


def table(out: Path) -> list[dict[str, str]]:
    return list(csv.DictReader((out / "metrics.csv").read_text().splitlines()))


def test_a_table_is_written_of_a_finished_sweep(whole: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    shutil.copytree(whole, out)
    assert sweep.main(["--resume", str(out), "--csv"]) == 0
    assert [(row["run"], int(row["epoch"])) for row in table(out)] == [
        (row["run"], row["epoch"]) for row in rows(out)
    ]


def files(path: Path) -> dict[Path, int]:
    return {one: one.stat().st_mtime_ns for one in path.rglob("*") if one.is_file()}


def test_a_dry_run_says_what_would_be_trained_and_makes_nothing(
    whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(dry_run, "MEASURED_SECONDS", 0.0)
    assert sweep.main([*OPTIONS, "--dry-run"]) == 0
    assert train(tmp_path / "out", "--dry-run", "--leave-at", "0.5") == 0
    assert not list(tmp_path.iterdir())
    out = capsys.readouterr().out
    names = {row["run"] for row in rows(whole)}
    assert all(out.count(f"   {name}\n") == 2 for name in names)
    assert out.count("2 runs in 1 program; nothing is written") == 2
    each = f"4 epochs of {rows(whole)[0]['env_steps']} environment steps each"
    assert f"\n1. {POINT_MASS}, cgm, ddpg: 2 runs side by side, {each}\n" in out
    assert len(re.findall(r" of memory( on 2 devices)?\n", out)) == 2
    assert re.search(r"\ntime: about \d+ s, \d+ s of it to compile, as measured just now; ", out)
    assert "\ntime: at most about " in out  # runs may leave


def test_a_dry_run_of_a_begun_sweep_takes_its_recorded_pace(
    whole: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    shutil.copytree(whole, out)
    lines = [json.loads(line) for line in (out / "metrics.jsonl").read_text().splitlines()]
    for line in lines:  # 120 s to compile, 1,000 s for an epoch
        line["wall_s"] = 120 + 1000 * line["epoch"]
    (out / "metrics.jsonl").write_text("".join(json.dumps(line) + "\n" for line in lines))
    before = files(out)
    assert sweep.main(["--resume", str(out), "--epochs", "7", "--dry-run"]) == 0
    text = capsys.readouterr().out
    assert "\ntime: about 52 min, 2 min of it to compile, as recorded there; " in text
    assert sweep.main(["--resume", str(out), "--dry-run"]) == 0
    assert capsys.readouterr().out.endswith("time: none, all is done\n")
    with pytest.raises(SettingError, match=r"^epochs: 3 are fewer"):
        sweep.main(["--resume", str(out), "--epochs", "3", "--dry-run"])
    assert files(out) == before


def test_a_sweep_starts_from_what_another_run_has_learned_also_when_it_begins_anew(
    whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out, run = tmp_path / "out", rows(whole)[0]["run"]
    start = ["--from", str(whole), "--from-run", run]
    assert train(out, *start) == 0
    first, scratch = rows(out)[0], rows(whole)[0]
    assert first["updates"] == scratch["updates"]  # counters are its own
    assert first["value"] != scratch["value"]
    with np.load(out / "start.npz") as file:
        source = {name: file[name] for name in file.files}
    there = final_state(whole)
    assert source
    assert all((array == there[name][0]).all() for name, array in source.items())
    assert train(out, *start) == 0  # the same command again
    origin = f"{whole}, {run}"
    assert json.loads((out / "config.json").read_text())["from"] == origin
    for other, text in (([], "nothing"), (start[:2], str(whole))):
        with pytest.raises(SettingError, match=f"from: .* begun from {origin}, not from {text}$"):
            train(out, *other)

    killed = tmp_path / "killed"  # before its first checkpoint
    stop_at_epoch(monkeypatch, 1, killed, *start)
    shutil.rmtree(killed / "checkpoints")
    assert sweep.main(["--resume", str(killed)]) == 0
    assert_same_results(out, killed)
    again = tmp_path / "again"
    assert sweep.main(["--config", str(out), "--out", str(again)]) == 0
    assert_same_results(out, again)
    (again / "start.npz").unlink()
    with pytest.raises(SettingError, match=r"from: .* but .*start.npz is missing$"):
        sweep.main(["--config", str(again), "--out", str(tmp_path / "more")])


def test_a_policy_that_does_not_fit_is_refused_before_anything_is_made(
    whole: Path, tmp_path: Path
) -> None:
    policy = next((whole / "policies").glob("*.npz"))
    with pytest.raises(SettingError, match=r"^from: its layers are 6x32x32x2 there and 6x8x2 "):
        train(tmp_path / "out", "--from", str(policy), "--hidden-layers", "8")
    assert not (tmp_path / "out").exists()


def test_sweeps_that_compare_numbers_of_epochs_are_not_trained_for_longer(tmp_path: Path) -> None:
    with RunDirectory.claimed(tmp_path / "out", fresh=True) as directory:
        directory.write_config(build_groups("smoke", {"epochs": [1, 2]}), "smoke", "cpu")
    with pytest.raises(SettingError, match=r"^epochs: .* compares 1 and 2 epochs, which stay$"):
        sweep.main(["--resume", str(directory.path), "--epochs", "4"])


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("", "config.json is damaged: JSONDecodeError"),
        ("[" * 100_000, "config.json is damaged"),
        ("{}", "config.json is damaged: KeyError: 'groups'"),
        ('{"groups": [{"settings": {"epochs": 3}}]}', "config.json is damaged: KeyError: 'runs'"),
        ('{"format": 99, "groups": []}', "config.json is damaged: format: 99 is none that this"),
        ('{"groups": []}', "config.json is damaged"),
    ],
)
def test_a_damaged_config_is_refused(text: str, complaint: str, tmp_path: Path) -> None:
    (tmp_path / "config.json").write_text(text)
    with pytest.raises(SettingError, match=complaint):
        sweep.main(["--resume", str(tmp_path)])


@pytest.mark.parametrize(("field", "value"), [("epochs", "4"), ("batch_size", 1.5), ("env", None)])
def test_a_config_with_a_value_of_the_wrong_type_is_refused(
    field: str, value: Any, whole: Path, tmp_path: Path
) -> None:
    config = json.loads((whole / "config.json").read_text())
    config["groups"][0]["runs"][0][field] = value
    (tmp_path / "config.json").write_text(json.dumps(config))
    with pytest.raises(SettingError, match=f"config.json is damaged: {field}: "):
        sweep.main(["--resume", str(tmp_path)])


def test_runs_that_diverge_are_named_and_marked_while_the_others_go_on(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out, grid = tmp_path / "out", ["--kappa", "4", "--critic-learning-rate", "1e-3", "1e30"]
    assert train(out, *grid) == 3
    captured = capsys.readouterr()
    bad = "point_mass-PointMass_ddpg-her_cgm-cg0.1-kappa4_criticlearningrate1e+30_seed0"
    reason = "critic not finite or beyond 1e+09"
    for row in rows(out):
        failed = (1, row["failure"]) if row["run"] == bad else (None, None)
        assert (row["failed_epoch"], row["failure"]) == failed
        assert failed[1] is None or "critic" in failed[1]
        assert (row["updates"] == 0) is (row["run"] == bad)
    assert f"{bad} diverged in epoch 1: " in captured.err
    assert "1 of 2 runs diverged" in captured.err
    assert f"diverged in epoch 1: {rows(out)[1]['failure']}" in captured.out
    assert reason.split()[1] in captured.out
    assert train(out, *grid) == 3  # a finished sweep says so again
    with np.load(out / "policies" / f"{bad}.npz") as file:
        assert all(np.isfinite(file[name]).all() for name in file.files)


@pytest.mark.slow
def test_memory_does_not_grow_while_training_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # 4,500 calls of the device: at two seconds each, as the host loop aims at, over an hour.
    taken: list[int] = []

    def measure() -> None:
        taken.append(int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize())

    for epoch in (200, 1500):
        at_epoch(monkeypatch, epoch, measure)
    assert train(tmp_path / "out", "--epochs", "1501", "--checkpoint-seconds", "1") == 0
    assert taken[1] - taken[0] < 20 * 2**20
