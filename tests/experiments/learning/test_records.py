import json
from pathlib import Path
from typing import Any

import pytest

from cgm_jax.grid import build_groups, split
from cgm_jax.host.run_directory import CONFIG, METRICS, RunDirectory
from experiments.learning import records

RATES: list[float | None] = [1.0, 0.12345, None]


def trained(path: Path, options: dict[str, list[Any]], rates: list[list[float | None]]) -> None:
    """A directory of two seeds, each of which got as far as its success rates go."""
    (group,) = build_groups("smoke", {"kappa": [4.0], "seed": [0, 1], "epochs": [5], **options})
    with RunDirectory.claimed(path, fresh=True) as directory:
        directory.write_config(split(group, 1), "smoke", "cpu")
    fixed = {"env": "reach", "c_g": 0.1, "kappa": 4.0, "her": True, "cgm": True, "wall_s": 1.5}
    fixed |= {"physics_warnings": 0.0, "failed_epoch": None}
    fixed |= dict.fromkeys(("mask_rate_estimated", "mask_rate_training", "mask_probability"), RATES)
    rows = [
        {
            **fixed,
            **{"run": run.name, "seed": run.hyper.seed, "success_rate": rate},
            **{"epoch": epoch, "env_steps": 100 * epoch, "updates": epoch},
        }
        for run, curve in zip(group.runs, rates, strict=True)
        for epoch, rate in enumerate(curve, start=1)
    ]
    (path / METRICS).write_text("".join(json.dumps(row) + "\n" for row in rows))


@pytest.fixture(autouse=True)
def _apart(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(records, "SWEEPS", tmp_path / "sweeps")


def test_rows_of_runs_that_are_done_come_back_as_they_were(tmp_path: Path) -> None:
    trained(tmp_path / "run", {}, [[0.0, 0.25, None, 0.5, 1.0], [0.0, 0.1]])
    records.record(RunDirectory(tmp_path / "run"), "mine")
    rows = records.recorded_rows("mine")
    assert [row["success_rate"] for row in rows] == [0.0, 0.25, None, 0.5, 1.0]  # seed 1 goes on
    originals = RunDirectory(tmp_path / "run").metrics()[:5]
    rounded = [1.0, 0.123, None]
    for row, original in zip(rows, originals, strict=True):
        rates = {name: rounded for name, value in original.items() if isinstance(value, list)}
        facts = {"sweep": "mine", "her_filter": False, "estimate": "product"}
        facts |= {"alone": True, "leave_at": None}
        assert row == {**facts, **original, **rates}
        assert {name: type(value) for name, value in row.items() if name in original} == {
            name: type(value) for name, value in original.items()
        }


def test_a_run_that_left_early_is_done(tmp_path: Path) -> None:
    trained(tmp_path / "run", {"leave_at": [0.5]}, [[0.0, 0.4, 0.6, 0.5], [0.0, 0.4, 0.6, 0.4]])
    records.record(RunDirectory(tmp_path / "run"), "mine")
    assert [(row["seed"], row["leave_at"]) for row in records.recorded_rows("mine")] == [
        (0, 0.5)
    ] * 4


@pytest.mark.parametrize(
    ("options", "estimate"),
    [
        ({}, "product"),
        ({"factorised": [False]}, "joint"),
        ({"masked_evaluation_episodes": [3]}, "measured"),
    ],
)
def test_a_record_tells_how_masks_were_judged(
    tmp_path: Path, options: dict[str, list[Any]], estimate: str
) -> None:
    trained(tmp_path / "run", options, [[1.0] * 5] * 2)
    records.record(RunDirectory(tmp_path / "run"), "mine")
    assert {row["estimate"] for row in records.recorded_rows("mine")} == {estimate}


def test_nothing_done_leaves_the_record_of_before(tmp_path: Path) -> None:
    trained(tmp_path / "first", {}, [[1.0] * 5] * 2)
    trained(tmp_path / "second", {}, [[1.0], []])
    for name in ("first", "second"):
        records.record(RunDirectory(tmp_path / name), "mine")
    assert len(records.recorded_rows("mine")) == 10
    assert records.recorded_rows("another") == []
    assert (tmp_path / "sweeps" / "mine" / CONFIG).is_file()
