"""Tables of the report from measurements made up."""

from pathlib import Path

import pytest

from experiments.physics import report_tables
from experiments.table import write_table


def test_the_timestep_is_shown_with_the_weld_that_has_the_smaller_grip_errors(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(report_tables, "RESULTS", tmp_path)
    (tmp_path / "fidelity").mkdir()
    rows = [
        {
            "task": task,
            "timestep": "0.004",
            "substeps": "10",
            "weld_time": weld,
            "median_largest_grip_error_mm": grip,
            "median_final_object_error_mm": block,
            "scripted_success": solved,
            "relative_speed": speed,
        }
        for task, weld, grip, block, solved, speed in (
            ("push", "0.02", 3.0, 1.0, 1.0, 2.0),
            ("push", "0.0205", 4.0, 2.0, 0.994, 1.0),
            ("pick_and_place", "0.02", 9.0, 1.0, 1.0, 2.0),
            ("pick_and_place", "0.0205", 5.04, 2.0, 1.0, 1.5),
        )
    ]
    write_table(tmp_path / "fidelity" / "timestep.csv", rows)
    (row,) = report_tables.timestep().rows
    assert list(row) == ["4 ms x 10", "4.0, 5.0", "2.0, 2.0", "99.4 %, 100 %", "1.2"]


def test_transfer_is_shown_per_environment(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(report_tables, "RESULTS", tmp_path)
    (tmp_path / "transfer").mkdir()
    rows = [
        {
            "environment": "FetchPush-v4",
            "episodes": "100",
            "success_there": there,
            "success_here": here,
            "loss": here - there,
            "same_outcome": 98.0,
        }
        for there, here in ((97.0, 99.0), (99.0, 96.0))
    ]
    write_table(tmp_path / "transfer" / "transfer.csv", rows)
    (row,) = report_tables.transfer().rows
    assert list(row) == ["FetchPush-v4", "2 x 100", "98.0 %", "97.5 %", "98.0 %", "-3 to 2"]


def test_the_start_is_shown_by_engine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(report_tables, "RESULTS", tmp_path)
    (tmp_path / "engines").mkdir()
    phases = {"libraries": 2, "tracing": 9.04, "compiling": 35, "first_cycle": 2, "together": 48}
    row = {f"{phase}_s": seconds for phase, seconds in phases.items()}
    write_table(tmp_path / "engines" / "start.csv", [{"engine": "mjx", **row}])
    (shown,) = report_tables.start().rows
    assert list(shown) == ["mjx", "2.0", "9.0", "35.0", "2.0", "48.0"]
