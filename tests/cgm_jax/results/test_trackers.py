"""What the trackers themselves read back: `make test-tracking`, which installs them.

Each of two runs is tracked by three processes: one is killed, one is killed and its last epoch
counts as not sent, one ends. All parts together hold each epoch once.
"""

# pyright: reportMissingImports=false, reportAttributeAccessIssue=false

import io
import os
import subprocess
import sys
from collections import Counter
from pathlib import Path
from typing import Any

import pytest
from PIL import Image

from cgm_jax.results.trackers.wandb import read_records
from cgm_jax.storage.run_directory import RunDirectory
from tests.cgm_jax.sweeps import ROOT

RUNS = ("one", "other")
EPOCHS = (1, 2, 3, 4, 5)
PART = """
import os, signal, sys, time
from pathlib import Path
from PIL import Image
from cgm_jax.config.grid import Run
from cgm_jax.results.tracking import Tracking

name, directory, how = sys.argv[1], sys.argv[2], sys.argv[5]
first, last = int(sys.argv[3]), int(sys.argv[4])
settings = {"c_g": 0.1, "env": "reach", "hidden_layers": (8, 8)}
runs = [Run(run, None, settings) for run in ("one", "other")]
record = Path(directory, "tracking", name + ".json")

def rows(*epochs):
    return [
        {"run": run.name, "c_g": 0.1, "epoch": n, "env_steps": 100 * n, "success_rate": n / 8,
         "subgoal_success": [n / 16, None]}
        for n in epochs for run in runs
    ]

with Tracking(name, Path(directory)) as tracking:
    tracking.begin(runs, rows(*range(1, first)))
    for epoch in range(first, last + 1):
        before = record.read_bytes()
        tracking.send(rows(epoch))
    if how == "killed":
        time.sleep(20 * (name == "wandb"))  # which writes every 15 s, in the background
        os.kill(os.getpid(), signal.SIGKILL)
    if how == "killed-early":
        record.write_bytes(before)  # as if it had been killed between the two
        os.kill(os.getpid(), signal.SIGKILL)
    still, moving = Path(directory, "curves.png"), Path(directory, "best.gif")
    Image.new("RGB", (40, 30), "red").save(still)
    frames = [Image.new("RGB", (32, 24), colour) for colour in ("black", "red")]
    frames[0].save(moving, save_all=True, append_images=frames[1:])
    tracking.show({"figures/curves": still, "best_policy": moving}, last)
"""


def track(name: str, directory: Path) -> None:
    """Track the runs in three processes, the directory being the working directory too."""
    variables = {key: value for key, value in os.environ.items() if not key.startswith("WANDB_")}
    variables |= {"TRACKIO_DIR": str(directory / "database"), "PYTHONPATH": str(ROOT)}
    for *part, code in (
        ("1", "2", "killed", -9),
        ("2", "4", "killed-early", -9),  # from a checkpoint of the first epoch
        ("4", "5", "ended", 0),
    ):
        result = subprocess.run(
            [sys.executable, "-c", PART, name, str(directory), *part],
            env=variables,
            cwd=directory,
            capture_output=True,
            text=True,
            check=False,
            timeout=120,
        )
        assert (result.returncode, result.stdout, result.stderr) == (code, "", ""), result.stderr


def test_tensorboard_reads_each_epoch_once(tmp_path: Path) -> None:
    event_accumulator = pytest.importorskip(
        "tensorboard.backend.event_processing.event_accumulator"
    )
    track("tensorboard", tmp_path)
    folder = tmp_path / "tracking/tensorboard"

    def read(run: str) -> Any:
        accumulator = event_accumulator.EventAccumulator(str(folder / run))
        return accumulator.Reload()

    for run in RUNS:
        events = read(run)
        assert sorted(events.Tags()["scalars"]) == [
            "env_steps",
            "subgoal_success/0",
            "success_rate",
        ]
        points = [(event.step, event.value) for event in events.Scalars("success_rate")]
        assert points == [(n, n / 8) for n in EPOCHS]
        (text,) = events.Tensors("settings")
        assert b'"c_g": 0.1' in text.tensor_proto.string_val[0]
    shown = read("sweep")
    assert sorted(shown.Tags()["images"]) == ["best_policy", "figures/curves"]
    (figure,) = shown.Images("figures/curves")
    assert (figure.step, figure.width, figure.height) == (5, 40, 30)
    assert Image.open(io.BytesIO(figure.encoded_image_string)).getpixel((0, 0)) == (255, 0, 0)
    (video,) = shown.Images("best_policy")
    assert Image.open(io.BytesIO(video.encoded_image_string)).n_frames == 2


def test_wandb_holds_each_epoch_once_over_the_parts_of_a_run(tmp_path: Path) -> None:
    pytest.importorskip("wandb")
    track("wandb", tmp_path)
    folder = tmp_path / "tracking/wandb/wandb"
    RunDirectory(tmp_path).config.restore()  # refuses links, of which wandb makes one
    parts = sorted(folder.glob("offline-run-*/*.wandb"))
    assert len(parts) == 7  # two runs in three processes, and the sweep
    steps: dict[str, list[int]] = {}
    values: dict[tuple[str, int], dict[str, str]] = {}
    identifiers: dict[str, set[str]] = {}
    media = Counter()
    for path in parts:
        records = list(read_records(path))
        opened = {(r.run.display_name, r.run.run_id) for r in records if r.HasField("run")}
        if not opened:  # of a process that was killed before anything arrived
            continue
        ((name, identifier),) = opened
        identifiers.setdefault(name, set()).add(identifier)
        settings = {
            item.key: item.value_json
            for record in records
            if record.HasField("run")
            for item in record.run.config.update
        }
        assert name == "sweep" or settings["c_g"] == "0.1"
        for record in records:
            if record.HasField("history"):
                row = {
                    ".".join(item.nested_key) or item.key: item.value_json
                    for item in record.history.item
                }
                step = int(row["_step"])
                steps.setdefault(name, []).append(step)
                values[name, step] = row
                media.update(key for key in row if key.endswith("._type"))
    assert {name: len(found) for name, found in identifiers.items()} == dict.fromkeys(
        (*RUNS, "sweep"), 1
    )
    for run in RUNS:
        assert steps[run] == list(EPOCHS)
        for n in EPOCHS:
            assert float(values[run, n]["success_rate"]) == n / 8
            assert float(values[run, n]["subgoal_success/0"]) == n / 16
    assert media == {"figures/curves._type": 1, "best_policy._type": 1}
    for suffix in ("gif", "png"):
        assert len(list(folder.glob(f"offline-run-*/files/media/**/*.{suffix}"))) == 1


def test_trackio_holds_each_epoch_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TRACKIO_DIR", str(tmp_path / "database"))
    trackio = pytest.importorskip("trackio")
    from trackio.sqlite_storage import SQLiteStorage

    track("trackio", tmp_path)
    found = {run.name.rpartition("/")[2]: run for run in trackio.Api().runs("cgm_jax")}
    assert sorted(found) == sorted((*RUNS, "sweep"))
    for run in RUNS:
        logs = SQLiteStorage.get_logs("cgm_jax", found[run].name, run_id=found[run].id)
        assert [(log["step"], log["success_rate"]) for log in logs] == [(n, n / 8) for n in EPOCHS]
        assert found[run].config["c_g"] == 0.1
    (log,) = SQLiteStorage.get_logs("cgm_jax", found["sweep"].name, run_id=found["sweep"].id)
    assert log["step"] == 5
    assert log["figures/curves"]["_type"] == "trackio.image"
    assert log["best_policy"]["_type"] == "trackio.video"
