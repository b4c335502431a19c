"""What a signal can wait for, and what begins with nothing to lose since it cannot."""

import os
import signal
from collections.abc import Callable
from concurrent.futures import Future
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from cgm_jax.config.grid import Group
from cgm_jax.config.settings import Settings
from cgm_jax.host import jobs, recorder, runner, session
from cgm_jax.host.checkpoint import TrainingProgress
from cgm_jax.host.pace import Pace
from cgm_jax.loop.compiler import Compiling
from cgm_jax.loop.cutting import Parts
from cgm_jax.storage.checkpoints import finished_checkpoints
from tests.cgm_jax.host.in_process import ALWAYS, EPOCHS, train
from tests.cgm_jax.sweeps import assert_same_results

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


@pytest.mark.parametrize(("seconds", "outlasts"), [(6.9, False), (7.1, True)])
def test_of_updates_that_are_the_first_nothing_is_known_but_the_rollout_that_they_could_cost(
    seconds: float, outlasts: bool
) -> None:
    job = jobs.Job(Group(Settings(cycles_per_epoch=1), ()), SimpleNamespace(), Parts(50, 20))  # pyright: ignore
    training: Any = SimpleNamespace(cycle=0, part=50)
    recorder: Any = SimpleNamespace(save_seconds=1.0, unsaved_seconds=lambda: 100.0)
    pace = Pace()
    pace.record("rollout", 50, seconds)
    assert runner._may_outlast_patience(job, training, recorder, pace) is outlasts
    pace.record_checkpoint()
    assert not runner._may_outlast_patience(job, training, recorder, pace)
    pace.record("updates", 2, 14.2)
    assert runner._may_outlast_patience(job, training, recorder, pace)
