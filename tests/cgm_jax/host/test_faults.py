"""Faults in random order; `make faults` runs fifty sequences more."""

import csv
import subprocess
import sys
from pathlib import Path

import pytest

from tests.cgm_jax.faults import SIGNALS, STEPS, TO_FILES, TO_PROCESS
from tests.cgm_jax.sweeps import ROOT

RECORD = ROOT / "experiments/results/faults/faults.csv"


@pytest.mark.slow
def test_after_any_sequence_of_faults_a_sweep_resumes_to_the_same_bits(tmp_path: Path) -> None:
    # A process of its own, since JAX has as many devices here as an earlier test let it have.
    out = tmp_path / "faults.csv"
    options = ["--first", "1000", "--sequences", "5", "--out", str(out)]
    subprocess.run([sys.executable, "-m", "tests.cgm_jax.faults", *options], cwd=ROOT, check=False)
    with out.open() as file:
        rows = list(csv.DictReader(file))
    for row in rows:
        print(row)
    assert {row["outcome"] for row in rows} == {"same bits"}
    assert len(rows) == 5 * STEPS


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
