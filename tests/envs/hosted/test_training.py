"""Training on a Gymnasium environment by the programs, its process included."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.cgm_jax.sweeps import ROOT, assert_same_results, command, finish, rows, stop

NAME = "gymnasium:tests.examples.numpy_point_mass:NumpyPointMass-v0"


@pytest.mark.slow
def test_a_stopped_run_gives_the_bits_of_one_that_was_not_and_needs_no_second_naming(
    tmp_path: Path,
) -> None:
    whole, cut = tmp_path / "whole", tmp_path / "cut"
    grid = ["--env", NAME, "--kappa", "4", "--epochs", "4"]
    finish(command(*grid, "--out", str(whole)))
    ending = ["--checkpoint-seconds", "0", "--out", str(cut)]
    code, text = stop(command(*grid, *ending), after="epoch 2:")
    assert code == 75, text
    assert 2 <= len(rows(cut)) < 4
    resume = [sys.executable, "-m", "cgm_jax.sweep", "--resume", str(cut)]
    finish(resume)
    assert_same_results(whole, cut)
    evaluate = [sys.executable, "-m", "cgm_jax.evaluate", str(cut), "--episodes", "6"]
    assert "6 episodes" in finish(evaluate).stdout


def test_the_process_refuses_in_one_line_what_it_cannot_serve(tmp_path: Path) -> None:
    (tmp_path / "broken.py").write_text("import sys\nprint('noise')\n1 / 0\n")
    result = subprocess.run(
        [*command("--env", "gymnasium:broken:X-v0", "--out", str(tmp_path / "out"))],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert result.returncode == 2
    line = result.stderr.splitlines()[-1]
    assert line.startswith("error: env: broken fails with ZeroDivisionError: division by zero")
    assert line.endswith("broken.py, line 3)")
    assert not (tmp_path / "out").exists()
