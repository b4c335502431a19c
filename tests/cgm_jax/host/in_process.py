"""Programs in this process: how they end, and sweeps on the point mass disturbed meanwhile."""

import os
import signal
from collections.abc import Callable
from contextvars import copy_context
from pathlib import Path
from typing import Any

import pytest

from cgm_jax import sweep
from cgm_jax.host import recorder
from cgm_jax.host.command_line import run_program
from tests.cgm_jax.sweeps import POINT_MASS

EPOCHS, RUNS = 4, 2
OPTIONS = ["--preset", "smoke", "--env", POINT_MASS, "--epochs", str(EPOCHS)]
ALWAYS = ["--checkpoint-seconds", "0"]


def outcome(
    main: Callable[[list[str]], int], arguments: list[str], capsys: pytest.CaptureFixture[str]
) -> tuple[Any, str, str]:
    """Exit code, output and errors of a program."""
    with pytest.raises(SystemExit) as end:
        copy_context().run(run_program, lambda: main(arguments))
    captured = capsys.readouterr()
    return end.value.code, captured.out, captured.err


def train(out: Path, *options: str) -> int:
    return sweep.main([*OPTIONS, "--out", str(out), *options])


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
