"""Faults in random order; `make faults` runs fifty sequences more."""

import csv
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.cgm_jax.faults import (
    SIGNALS,
    STEPS,
    TO_FILES,
    TO_PROCESS,
    compiled_once,
    run_sequence,
    undisturbed,
)
from tests.cgm_jax.sweeps import ROOT

RECORD = ROOT / "experiments/results/faults/faults.csv"


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    with compiled_once():
        yield undisturbed(tmp_path_factory.mktemp("whole") / "out")


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(1000, 1005))
def test_after_any_sequence_of_faults_a_sweep_resumes_to_the_same_bits(
    seed: int, whole: Path, tmp_path: Path
) -> None:
    steps = 0
    for step in run_sequence(seed, tmp_path, whole):
        print(step)
        steps += 1
    assert steps == STEPS


def test_fifty_sequences_on_record_each_resumed_to_the_same_bits() -> None:
    with RECORD.open() as file:
        rows = list(csv.DictReader(file))
    assert {row["outcome"] for row in rows} == {"same bits"}
    assert sorted({int(row["seed"]) for row in rows}) == list(range(50))
    assert len(rows) == 50 * STEPS
    codes: dict[str, set[str]] = {row["fault"]: set() for row in rows}
    for row in rows:
        codes[row["fault"]].add(row["code"])
    assert {*TO_PROCESS, *TO_FILES} == {*codes}
    assert "-9" in codes["kill -9"]
    assert "74" in codes["full disk"]
    assert all("75" in codes[name] for name in SIGNALS if name != "SIGHUP")
