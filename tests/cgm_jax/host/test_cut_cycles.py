"""Sweeps whose cycles are cut: a signal in the middle of one loses nothing of it."""

import os
import signal
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from cgm_jax.config.grid import Group
from cgm_jax.config.settings import Settings
from cgm_jax.host import jobs, runner
from cgm_jax.host.checkpoint import TrainingProgress
from cgm_jax.loop import cutting
from cgm_jax.loop.cutting import Parts
from cgm_jax.storage.checkpoints import finished_checkpoints, position_of
from tests.cgm_jax.host.in_process import EPOCHS, RUNS, train
from tests.cgm_jax.sweeps import assert_same_results, final_state, rows

pytestmark = pytest.mark.usefixtures("in_process")

# 25 steps and two parts of two updates each; a batch size of their own, so that no other test's
# whole cycles are taken for theirs.
PARTS = 27
OPTIONS = ["--batch-size", "24"]


@pytest.fixture(autouse=True)
def cut(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cutting, "WHOLE_STEPS", 0)
    monkeypatch.setattr(cutting, "PART_TRANSITIONS", 2 * 24)
    monkeypatch.setattr("cgm_jax.host.pace.CHUNK_SECONDS", 0.0)  # a part at a time


def stop_after(parts: int, monkeypatch: pytest.MonkeyPatch, out: Path) -> list[tuple[int, int]]:
    """Train until a signal comes during a part; cycles and parts at which parts have begun."""
    begun, train_chunk = [], runner._train_chunk

    def chunk(job: Any, training: TrainingProgress, *rest: Any) -> None:
        begun.append((training.cycle, training.part))
        if len(begun) == parts:
            os.kill(os.getpid(), signal.SIGTERM)
        train_chunk(job, training, *rest)

    with monkeypatch.context() as patch:
        patch.setattr(runner, "_train_chunk", chunk)
        assert train(out, *OPTIONS) == 75
    return begun


@pytest.mark.slow
def test_a_signal_in_the_middle_of_a_cycle_ends_with_all_of_it_that_is_done(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole, out = tmp_path / "whole", tmp_path / "out"
    assert train(whole, *OPTIONS) == 0
    begun = stop_after(7, monkeypatch, out)  # while the episodes go on
    assert begun == [(0, part) for part in range(7)]
    (last,) = finished_checkpoints(out / "checkpoints", 0)
    assert last.stem == "group0_epoch000000_cycle000000_part000007"
    begun = stop_after(PARTS + 19, monkeypatch, out)  # with half of the next cycle's updates done
    assert begun[0] == (0, 7)
    assert begun[-1] == (1, PARTS - 2)
    last = finished_checkpoints(out / "checkpoints", 0)[-1]
    assert last.stem == f"group0_epoch000000_cycle000001_part{PARTS - 1:06d}"
    assert position_of(last) == (0, 1, PARTS - 1)
    assert train(out, *OPTIONS) == 0
    assert len(rows(out)) == EPOCHS * RUNS
    assert_same_results(whole, out)
    assert not any(name.startswith(".unfinished.") for name in final_state(whole))


def test_what_comes_next_is_alike_until_it_ends() -> None:
    job = jobs.Job(Group(Settings(cycles_per_epoch=2), ()), SimpleNamespace(), Parts(50, 20))  # pyright: ignore

    def ahead(cycle: int, part: int) -> tuple[str, int]:
        return runner._units_ahead(job, SimpleNamespace(cycle=cycle, part=part))  # pyright: ignore

    assert ahead(0, 0) == ("rollout", 50)
    assert ahead(1, 49) == ("rollout", 1)
    assert ahead(1, 50) == ("updates", 20)
    assert ahead(1, 69) == ("updates", 1)
    assert ahead(2, 0)[1] == 0
    assert ahead(3, 0)[1] == 0  # of a directory that asks for fewer now


def test_a_damaged_checkpoint_of_a_part_leaves_the_one_before(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    for parts in (3, 4):
        stop_after(parts, monkeypatch, out)
    before, last = finished_checkpoints(out / "checkpoints", 0)
    assert [path.stem[-6:] for path in (before, last)] == ["000003", "000007"]
    last.write_bytes(last.read_bytes()[:-1])
    capfd.readouterr()
    # Not in the first part, where a signal ends the process at once: there is nothing to lose.
    assert stop_after(2, monkeypatch, out) == [(0, 3), (0, 4)]
    assert f"{last} is damaged" in capfd.readouterr().err
