"""Whole sweeps on the point mass, in this process; processes of their own are in test_resume.py."""

import asyncio
import builtins
import contextlib
import csv
import dataclasses
import io
import json
import resource
import shutil
import signal
import sys
import threading
import time
from collections.abc import Iterator
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
from cgm_jax.config.grid import Group, run_of
from cgm_jax.config.settings import Settings
from cgm_jax.host import beginning, jobs
from cgm_jax.host.checkpoint import TrainingProgress
from cgm_jax.results import figures
from cgm_jax.results.figures import draw_figures
from tests.cgm_jax.host.in_process import (
    ALWAYS,
    RUNS,
    at_epoch,
    stop_at_epoch,
    train,
)
from tests.cgm_jax.shared_programs import SharedPrograms
from tests.cgm_jax.sweeps import assert_same_results, final_state, rows
from tests.examples.point_mass import PointMass

pytestmark = pytest.mark.usefixtures("in_process")


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
    command = json.loads((tmp_path / "notebook/config.json").read_text())["command"]
    assert command[:3] == ["python", "-m", "cgm_jax.sweep"]
    assert command[-2:] == ["--out", str(tmp_path / "notebook")]  # and not what pytest was given


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
    assert beginning.is_finished(group, training) == finished
    training.cycle = 1  # in the middle of an epoch nothing is decided
    assert not beginning.is_finished(group, training)


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


def test_a_group_that_begins_anew_without_what_it_started_from_is_refused(
    whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "out"
    start = ["--from", str(whole), "--from-run", rows(whole)[0]["run"]]
    stop_at_epoch(monkeypatch, 1, out, *start)
    kept = (out / "start.npz").read_bytes()
    (out / "start.npz").unlink()
    (last,) = (out / "checkpoints").glob("*.npz")
    last.write_bytes(last.read_bytes()[:-1])  # of which only reading tells
    line = rf"^from: .*config.json began from .*, but {out / 'start.npz'} is missing$"
    with pytest.raises(SettingError, match=line):
        sweep.main(["--resume", str(out)])
    shutil.rmtree(out / "checkpoints")
    monkeypatch.setenv("JAX_NOW", "x")  # which resuming would record
    config = (out / "config.json").read_bytes()
    with pytest.raises(SettingError, match=line):
        sweep.main(["--resume", str(out)])
    assert (out / "config.json").read_bytes() == config
    with np.load(io.BytesIO(kept)) as file:
        arrays = {name: file[name][..., :1] if file[name].ndim else file[name] for name in file}
    np.savez(out / "start.npz", **arrays)
    with pytest.raises(SettingError, match=r"^from: .* in the source and .* here$"):
        sweep.main(["--resume", str(out)])
    (out / "start.npz").write_bytes(kept)
    assert sweep.main(["--resume", str(out)]) == 0


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
