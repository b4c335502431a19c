"""A sweep that was stopped or killed gives the bits of one that was not."""

import random
import signal
import subprocess
import time
from pathlib import Path

import pytest

from tests.cgm_jax.sweeps import (
    POINT_MASS,
    ROOT,
    assert_same_results,
    command,
    finish,
    rows,
    stop,
)

ALWAYS = ["--checkpoint-seconds", "0"]
NEVER = ["--checkpoint-seconds", "1e9"]


@pytest.mark.slow
@pytest.mark.parametrize("engine", ["native", "mjx"])
def test_a_stopped_sweep_gives_the_bits_of_one_that_was_not(engine: str, tmp_path: Path) -> None:
    grid = ["--env", "reach", "--engine", engine, "--epochs", "4", "--evaluation-episodes", "4"]
    whole, cut = tmp_path / "whole", tmp_path / "cut"
    finish(command(*grid, *NEVER, "--out", str(whole)))
    code, text = stop(command(*grid, *ALWAYS, "--out", str(cut)), after="epoch 2:")
    assert code == 75, text
    assert 4 <= len(rows(cut)) < 8
    assert list((cut / "policies").glob("*.npz"))  # a stopped sweep has policies and figures
    assert (cut / "figures" / "learning_curves.png").is_file()
    finish(command(*grid, *NEVER, "--out", str(cut)))
    assert len(rows(cut)) == 8
    assert_same_results(whole, cut)


@pytest.mark.slow
def test_kill_9_at_any_moment_loses_nothing_but_time(tmp_path: Path) -> None:
    grid = ["--env", POINT_MASS, "--epochs", "150", "--seeds", "1"]
    whole, killed = tmp_path / "whole", tmp_path / "killed"
    finish(command(*grid, *NEVER, "--out", str(whole)))
    draw = random.Random(0)
    first = command(*grid, *ALWAYS, "--out", str(killed))
    again = [*first[:3], "--resume", str(killed), *ALWAYS]
    for arguments in (first, again, first, again, again):
        epochs, delay = draw.randint(1, 25), draw.uniform(0, 0.1)
        with subprocess.Popen(arguments, stderr=subprocess.PIPE, text=True, cwd=ROOT) as process:
            assert process.stderr is not None
            for line in process.stderr:
                epochs -= line.startswith("epoch ")
                if epochs < 1:
                    break
            time.sleep(delay)
            process.kill()
            assert process.wait() == -signal.SIGKILL
    done = rows(killed)[-1]["epoch"]
    assert 1 < done < 150
    finish(again)
    assert len(rows(killed)) == 2 * 150
    assert_same_results(whole, killed)
