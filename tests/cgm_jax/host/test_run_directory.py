import json
import subprocess
from pathlib import Path

import pytest

from cgm_jax.grid import build_groups
from cgm_jax.host.run_directory import CONFIG, RunDirectory
from tests.cgm_jax.sweeps import ROOT


@pytest.mark.skipif(not (ROOT / ".git").exists(), reason="no checkout")
def test_the_config_names_the_commit_that_trains(tmp_path: Path) -> None:
    with RunDirectory.claimed(tmp_path, fresh=True) as directory:
        directory.write_config(build_groups("smoke", {}), "smoke", "cpu")
    command = ["git", "-C", str(ROOT), "rev-parse", "HEAD"]
    head = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    commit = json.loads((tmp_path / CONFIG).read_text())["commit"]
    assert head.startswith(commit.removesuffix("-dirty"))
