"""Training on a Gymnasium environment by the programs, its process included."""

import sys
from pathlib import Path

import pytest

from cgm_jax import sweep
from tests.cgm_jax.host.in_process import outcome
from tests.cgm_jax.sweeps import assert_same_results, command, finish, rows, stop

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


def test_what_it_cannot_serve_is_refused_in_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "broken.py").write_text("import sys\nprint('noise')\n1 / 0\n")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.chdir(tmp_path)
    words = ["--preset", "smoke", "--env", "gymnasium:broken:X-v0", "--out", "out"]
    code, _, text = outcome(sweep.main, words, capsys)
    assert code == 2
    line = text.splitlines()[-1]
    assert line.startswith("error: env: broken fails with ZeroDivisionError: division by zero")
    assert line.endswith("broken.py, line 3)")
    assert not (tmp_path / "out").exists()
