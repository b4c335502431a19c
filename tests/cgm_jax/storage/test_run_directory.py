import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from cgm_jax.config.grid import build_groups
from cgm_jax.storage.run_directory import CONFIG, RunDirectory
from tests.cgm_jax.sweeps import ROOT


@pytest.mark.skipif(not (ROOT / ".git").exists(), reason="no checkout")
def test_the_config_names_the_commit_that_trains(tmp_path: Path) -> None:
    with RunDirectory.claimed(tmp_path, fresh=True) as directory:
        directory.write_config(build_groups("smoke", {}), "smoke", "cpu")
    command = ["git", "-C", str(ROOT), "rev-parse", "HEAD"]
    head = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    commit = json.loads((tmp_path / CONFIG).read_text())["commit"]
    assert head.startswith(commit.removesuffix("-dirty"))


@pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="processes cannot be bound")
def test_the_config_tells_on_how_many_cores_its_seconds_were_spent(tmp_path: Path) -> None:
    program = """
import os, pathlib, sys
from cgm_jax.config.grid import build_groups
from cgm_jax.storage.run_directory import RunDirectory
os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[:1])
with RunDirectory.claimed(pathlib.Path(sys.argv[1]), fresh=True) as directory:
    directory.write_config(build_groups("smoke", {}), "smoke", "cpu")
"""
    subprocess.run([sys.executable, "-c", program, str(tmp_path)], check=True, cwd=ROOT)
    machine = json.loads((tmp_path / CONFIG).read_text())["machine"]
    there = os.cpu_count()
    assert machine.endswith(", 1 cores" if there == 1 else f", 1 of {there} cores")


def test_what_has_changed_since_a_sweep_was_begun_is_named(tmp_path: Path) -> None:
    with RunDirectory.claimed(tmp_path, fresh=True) as directory:
        directory.write_config(build_groups("smoke", {}), "smoke", "cpu")
    assert directory.changes_since_begun() == []
    config = json.loads((tmp_path / CONFIG).read_text())
    now = config["versions"]["jax"], config["machine"]
    config["versions"]["jax"], config["machine"] = "0.0.1", "another"
    (tmp_path / CONFIG).write_text(json.dumps(config))
    assert directory.changes_since_begun() == [
        f"jax 0.0.1 (now {now[0]})",
        f"another (now {now[1]})",
    ]
