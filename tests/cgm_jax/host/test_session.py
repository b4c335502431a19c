"""Whole sweeps on the point mass, in this process; processes of their own are in test_resume.py."""

import asyncio
import builtins
import contextlib
import csv
import dataclasses
import io
import json
import os
import resource
import shutil
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import jax
import mujoco
import numpy as np
import pytest
from brax.envs.base import State
from jax.experimental.buffer_callback import buffer_callback

from cgm_jax import sweep
from cgm_jax.config.fields import SettingError
from cgm_jax.config.grid import Group, run_of
from cgm_jax.config.settings import Settings
from cgm_jax.host import jobs, recorder, runner, session
from cgm_jax.host.checkpoint import TrainingProgress
from cgm_jax.host.pace import Pace
from cgm_jax.loop.compiler import Compiling
from cgm_jax.results import figures
from cgm_jax.results.figures import draw_figures
from cgm_jax.storage.checkpoints import finished_checkpoints
from tests.cgm_jax.host.in_process import (
    ALWAYS,
    EPOCHS,
    RUNS,
    at_epoch,
    stop_at_epoch,
    train,
)
from tests.cgm_jax.shared_programs import SharedPrograms
from tests.cgm_jax.sweeps import assert_same_results, final_state, rows
from tests.examples.point_mass import PointMass

pytestmark = pytest.mark.usefixtures("in_process")


@pytest.mark.parametrize(
    ("cycle", "cycle_seconds", "evaluation_seconds", "outlasts"),
    [
        (1, 5.0, None, False),
        (1, 6.1, None, True),  # it takes 2 s to save, and patience is 8 s
        (2, 2.0, None, False),  # an evaluation, of which nothing is known but what it could lose
        (2, 3.1, None, True),
        (2, 3.1, 5.0, False),
        (2, 2.0, 6.1, True),
    ],
)
def test_what_outlasts_a_signals_patience(
    cycle: int, cycle_seconds: float, evaluation_seconds: float | None, outlasts: bool
) -> None:
    assert outlasts_patience(cycle, cycle_seconds, evaluation_seconds) is outlasts
    # On a slow disk, most of the time is for training.
    assert not outlasts_patience(
        cycle, cycle_seconds, evaluation_seconds, save_seconds=60.0, unsaved_seconds=230.0
    )
    assert outlasts_patience(1, 0.5, save_seconds=60.0, unsaved_seconds=250.0)


def test_an_evaluation_that_still_compiles_outlasts_patience_if_something_is_to_lose() -> None:
    compiling = Compiling(Future())
    assert outlasts_patience(2, 1.1, evaluate=compiling)
    assert not outlasts_patience(2, 0.9, evaluate=compiling)


def outlasts_patience(
    cycle: int,
    cycle_seconds: float,
    evaluation_seconds: float | None = None,
    *,
    save_seconds: float = 2.0,
    unsaved_seconds: float = 100.0,
    evaluate: Callable[..., Any] = len,  # compiled, as far as anybody knows
) -> bool:
    """What the runner holds of what comes after so many of an epoch's two cycles."""
    programs: Any = SimpleNamespace(evaluate=evaluate)
    job = jobs.Job(Group(Settings(cycles_per_epoch=2), ()), programs)
    training: Any = SimpleNamespace(cycle=cycle, part=0)
    recorder: Any = SimpleNamespace(
        save_seconds=save_seconds, unsaved_seconds=lambda: unsaved_seconds
    )
    pace = Pace()
    if evaluation_seconds is not None:
        pace.record_evaluation(evaluation_seconds)
    pace.record("cycle", cycle, cycle * cycle_seconds)
    return runner._may_outlast_patience(job, training, recorder, pace)


def test_a_signal_while_a_checkpoint_is_written_ends_with_that_one(
    whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out, save = tmp_path / "out", recorder.Recorder.save

    def saving(self: recorder.Recorder, training: TrainingProgress) -> None:
        if (training.epoch, training.cycle) == (1, 0):
            os.kill(os.getpid(), signal.SIGTERM)
        save(self, training)

    with monkeypatch.context() as patch:
        patch.setattr(recorder.Recorder, "save", saving)
        assert train(out, *ALWAYS) == 75
    last = finished_checkpoints(out / "checkpoints", 0)[-1]
    assert last.stem == "group0_epoch000001_cycle000000"
    assert train(out) == 0
    assert_same_results(whole, out)


def test_all_else_is_done_before_what_still_compiles_is_waited_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, shared_programs: SharedPrograms
) -> None:
    done: list[str] = []

    @contextlib.contextmanager
    def compiler() -> Iterator[Any]:
        yield shared_programs.compiler
        done.append("waited")

    monkeypatch.setattr("cgm_jax.loop.compiler.Compiler", compiler)
    monkeypatch.setattr(figures, "draw_figures", lambda _: done.append("figures"))
    assert train(tmp_path / "out") == 0
    assert done == ["figures", "waited"]


def test_what_a_signal_cannot_wait_for_begins_with_nothing_to_lose(
    whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    listening, begun = [], []
    listen, train_chunk, close_epoch = (
        session.Interruption,
        runner._train_chunk,
        runner._close_epoch,
    )

    def remembered(**options: Any) -> Any:
        listening.append(listen(**options))
        return listening[-1]

    def note(training: TrainingProgress) -> None:
        saved = finished_checkpoints(tmp_path / "out" / "checkpoints", 0)[-1:]
        stem = f"group0_epoch{training.epoch:06d}_cycle{training.cycle:06d}"
        begun.append((listening[0].expendable, [path.stem for path in saved] == [stem]))

    def chunk(job: jobs.Job, training: TrainingProgress, *rest: Any) -> None:
        note(training)
        train_chunk(job, training, *rest)

    def close(programs: Any, training: TrainingProgress, *rest: Any) -> Any:
        note(training)
        return close_epoch(programs, training, *rest)

    monkeypatch.setattr(session, "Interruption", remembered)
    monkeypatch.setattr(runner, "_train_chunk", chunk)
    monkeypatch.setattr(runner, "_close_epoch", close)
    monkeypatch.setattr(runner, "PATIENCE_SECONDS", 0.0)  # as if all of them took longer
    monkeypatch.setattr(recorder.Recorder, "unsaved_seconds", lambda _: 100.0)
    assert train(tmp_path / "out") == 0
    # Before the first cycle there is nothing to lose but the beginning.
    assert begun[0] == (True, False)
    assert begun[1:] == [(True, True)] * (len(begun) - 1)
    assert len(begun) > 2 * EPOCHS
    assert_same_results(whole, tmp_path / "out")


def test_the_same_command_resumes_and_a_finished_sweep_stays_as_it_is(
    whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    monkeypatch.setattr(figures, "draw_figures", draw_figures)
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
    monkeypatch.setattr(jobs, "make_environment", lambda _: Breaking())
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


def table(out: Path) -> list[dict[str, str]]:
    return list(csv.DictReader((out / "metrics.csv").read_text().splitlines()))


def test_a_table_is_written_of_a_finished_sweep(whole: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    shutil.copytree(whole, out)
    assert sweep.main(["--resume", str(out), "--csv"]) == 0
    assert [(row["run"], int(row["epoch"])) for row in table(out)] == [
        (row["run"], row["epoch"]) for row in rows(out)
    ]


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
