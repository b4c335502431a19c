"""What `make gpu` does, its cases in small."""

import json
import math
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from cgm_jax.config.fields import SettingError
from cgm_jax.envs.physics.choose import has_warp
from cgm_jax.host.exit_codes import ExitCode
from experiments.gpu import cases, measure
from experiments.gpu.cases import PARTS
from experiments.table import read_table
from tests.cgm_jax.sweeps import ROOT

SLOW_PARENT = 'sleep 60 & echo $! > "$0"; wait'


def test_every_part_has_cases_in_both_sizes() -> None:
    assert set(measure.CASES) == set(measure.REHEARSED) == set(PARTS)
    assert all(measure.CASES.values())
    assert all(measure.REHEARSED.values())


def test_a_case_that_ends_says_how() -> None:
    talk = "import sys; print(1); print(2, file=sys.stderr); sys.exit(3)"
    assert measure.run_within([sys.executable, "-c", talk], 60.0) == (3, "1\n", "2\n")


def test_a_case_that_takes_too_long_ends_with_all_that_it_started(tmp_path: Path) -> None:
    noted = tmp_path / "pid"
    assert measure.run_within(["sh", "-c", SLOW_PARENT, str(noted)], 2.0) is None
    child = int(noted.read_text())
    for _ in range(100):  # it is init's to bury
        stat = Path(f"/proc/{child}/stat")
        if not stat.exists() or ") Z" in stat.read_text():
            return
        time.sleep(0.05)
    os.kill(child, signal.SIGKILL)
    pytest.fail("the child was left running")


def test_a_run_that_diverged_has_figures(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    row = {"env_steps": 51200, "wall_s": 9.0, "success_rate": None}
    (tmp_path / "learning" / "push").mkdir(parents=True)
    (tmp_path / "learning" / "push" / "metrics.jsonl").write_text(json.dumps(row) + "\n")

    def diverged(command: list[str], accepted: tuple[int, ...]) -> str:
        assert ExitCode.DIVERGED in accepted
        return ""

    monkeypatch.setattr(cases, "output_of", diverged)
    figures = {row["figure"]: row["value"] for row in cases.learning("push", False, tmp_path)}
    assert figures["environment steps trained"] == 51200
    assert math.isnan(figures["success in the end"])


def test_without_a_gpu_it_is_refused(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(measure, "_device", lambda: "cpu x 1")
    with pytest.raises(SettingError, match="no GPU here"):
        measure.main(["--out", str(tmp_path / "out")])
    assert not (tmp_path / "out").exists()


def test_cases_that_are_on_record_are_not_measured_again(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    asked: list[tuple[str, str]] = []

    def stand_in(part: str, case: str, *_: object) -> list[dict[str, object]] | str:
        asked.append((part, case))
        if asked == [("updates", "all")]:
            return "broke"
        return [{"figure": "rate", "value": 2.5, "unit": "steps/s"}]

    monkeypatch.setattr(measure, "_device", lambda: "card x 1")
    monkeypatch.setattr(measure, "_measure", stand_in)
    monkeypatch.setattr(measure, "has_warp", lambda: False)
    cases = {"rate_warp": ("64",), "updates": ("all",), "runs": ("1", "8")}
    monkeypatch.setattr(measure, "CASES", cases)
    options = ["--out", str(tmp_path)]
    assert measure.main(options) == 1
    assert asked == [("updates", "all"), ("runs", "1"), ("runs", "8")]
    assert "missing: updates all: broke" in (tmp_path / "gpu.txt").read_text()
    assert measure.main(options) == 0
    assert asked[3:] == [("updates", "all")]
    rows = read_table(tmp_path / "gpu.csv")
    assert [(row["device"], row["part"], row["case"]) for row in rows] == [
        ("card x 1", "runs", "1"),
        ("card x 1", "runs", "8"),
        ("card x 1", "updates", "all"),
    ]
    text = (tmp_path / "gpu.txt").read_text()
    assert "missing" not in text
    assert text.endswith("left out: rate_warp, since warp-lang is not installed\n")


@pytest.mark.slow
def test_all_of_it_is_rehearsed_on_a_cpu(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "experiments.gpu.measure", "--rehearse"]
    subprocess.run([*command, "--out", str(tmp_path)], check=True, cwd=ROOT)
    rows = read_table(tmp_path / "gpu.csv")
    measured = {(row["part"], row["case"]) for row in rows}
    left_out = [] if has_warp() else ["rate_warp", "parity_warp"]
    assert measured == {
        (part, case)
        for part, cases in measure.REHEARSED.items()
        for case in cases
        if part not in left_out
    }
    figures = {(row["part"], row["figure"]): float(row["value"]) for row in rows}
    # Two engines, which never agree to the last bit.
    assert 0.0 < figures["parity_mjx", "grip strays in free motion at most"] < 1.0
    assert figures["memory", "estimate / taken"] > 0.5
    assert figures["learning", "environment steps trained"] > 0
