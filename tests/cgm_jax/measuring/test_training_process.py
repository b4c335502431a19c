"""Processes of a stand-in whose epochs cost what they are told."""

import os
import time
from pathlib import Path

import pytest

from cgm_jax.config.fields import SettingError
from cgm_jax.measuring import training_process
from cgm_jax.measuring.checkouts import Checkout
from cgm_jax.measuring.training_process import (
    MeasurementError,
    TrainingProcess,
    process_times,
)
from tests.cgm_jax.measuring.stand_in import write_checkout

TOLERANCE = 0.05
"""Of CPU seconds: they come in ticks of 10 ms, and the stand-in does other things as well."""


@pytest.fixture
def checkout(tmp_path: Path) -> Checkout:
    write_checkout(tmp_path / "checkout", start=0.1, epoch=0.2)
    return Checkout(tmp_path / "checkout", "abcdef")


def training(checkout: Checkout, tmp_path: Path, *options: str) -> TrainingProcess:
    return TrainingProcess(checkout, options, tmp_path / "scratch")


def test_each_epoch_costs_what_it_takes(checkout: Checkout, tmp_path: Path) -> None:
    with training(checkout, tmp_path) as process:
        first = process.train_epoch()
        later = [process.train_epoch() for _ in range(3)]
    assert first.env_steps == 100
    assert first.cpu_s >= 0.3  # the interpreter's own start besides
    for cost in later:
        assert cost.env_steps == 100
        assert cost.cpu_s == pytest.approx(0.2, abs=TOLERANCE)
        assert cost.wall_s >= 0.2 - TOLERANCE


def test_nothing_runs_or_counts_between_epochs(checkout: Checkout, tmp_path: Path) -> None:
    with training(checkout, tmp_path) as process:
        process.train_epoch()
        sweep = tmp_path / "scratch" / "sweep"
        pid, lines = int((sweep / "pid").read_text()), (sweep / "metrics.jsonl").read_text()
        before = process_times(pid)
        time.sleep(0.6)  # of three epochs
        assert process_times(pid) == before
        assert before[0] == "T"
        assert (sweep / "metrics.jsonl").read_text() == lines
        began = time.monotonic()
        cost = process.train_epoch()
        assert cost.wall_s <= time.monotonic() - began
        assert cost.cpu_s == pytest.approx(0.2, abs=TOLERANCE)


def test_runs_that_train_side_by_side_are_counted(checkout: Checkout, tmp_path: Path) -> None:
    with training(checkout, tmp_path, "--runs", "3") as process:
        steps = [process.train_epoch().env_steps for _ in range(2)]
        assert steps == [100, 100]
        assert process.runs() == 3


def test_the_process_ends_with_the_block(checkout: Checkout, tmp_path: Path) -> None:
    with training(checkout, tmp_path) as process:
        process.train_epoch()
        pid = int((tmp_path / "scratch" / "sweep" / "pid").read_text())
        os.kill(pid, 0)
    with pytest.raises(ProcessLookupError):
        os.kill(pid, 0)


@pytest.mark.parametrize("options", [["--epochs", "2"], ["--epochs", "2", "--groups", "2"]])
def test_a_sweep_without_further_epochs_is_named(
    checkout: Checkout, tmp_path: Path, options: list[str]
) -> None:
    # Also one that moves on to other runs, whose epochs count from one again.
    with training(checkout, tmp_path, *options) as process:
        process.train_epoch()
        process.train_epoch()
        with pytest.raises(MeasurementError, match=r"at abcdef trains .* for 2 epochs only"):
            process.train_epoch()


def test_an_epoch_with_which_the_sweep_ends_counts(
    checkout: Checkout, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(training_process, "POLL_SECONDS", 2.0)  # it has ended when that is noticed
    with training(checkout, tmp_path, "--epochs", "1") as process:
        assert process.train_epoch().env_steps == 100
        with pytest.raises(MeasurementError, match=r"at abcdef trains .* for 1 epoch only"):
            process.train_epoch()


def test_a_sweep_that_fails_says_so(checkout: Checkout, tmp_path: Path) -> None:
    with (
        training(checkout, tmp_path, "--fail", "1") as process,
        pytest.raises(MeasurementError, match="ended with exit code 1: error: told to fail"),
    ):
        process.train_epoch()


def test_refused_options_are_bad_input_here_too(checkout: Checkout, tmp_path: Path) -> None:
    with (
        training(checkout, tmp_path, "--fail", "2") as process,
        pytest.raises(SettingError, match=r"cgm_jax\.sweep --fail 2 at abcdef: told to fail"),
    ):
        process.train_epoch()
