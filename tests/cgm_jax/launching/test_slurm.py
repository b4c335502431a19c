"""Launches on a real SLURM, by `make test-slurm`, which starts one (see slurm.sh)."""

import os
import signal
import subprocess
import time
from pathlib import Path

import pytest

from cgm_jax.launching.record import events
from tests.cgm_jax.launching.launches import (
    assert_as_if_never_disturbed,
    attempts,
    begun,
    launch,
    trainer,
    uninterrupted,
    wait_for_checkpoint,
    wait_until,
)
from tests.cgm_jax.sweeps import ROOT

if "cgm_jax-slurm" not in os.environ.get("SLURM_CONF", ""):
    pytest.skip("needs the SLURM that `make test-slurm` starts", allow_module_level=True)

pytestmark = pytest.mark.slow


def job_of(out: Path, part: int) -> str:
    """The job last submitted for a part."""
    entries = events(out / "attempts" / f"{part}.jsonl")
    return [entry["job"] for entry in entries if entry["event"] == "submitted"][-1]


def launches(out: Path) -> int:
    """How often the launcher has begun."""
    return [entry["event"] for entry in events(out / "attempts/1.jsonl")].count("launched")


def slurm(*words: str) -> str:
    """What a command of SLURM prints."""
    return subprocess.run(words, check=True, capture_output=True, text=True).stdout


def test_jobs_that_are_requeued_signalled_and_killed_lose_nothing(tmp_path: Path) -> None:
    whole, out = uninterrupted(tmp_path / "whole"), tmp_path / "out"
    with begun(launch("slurm", out)) as process:
        # Requeued by an administrator, or since its node failed.
        first = wait_for_checkpoint(process, out, 1)
        slurm("scontrol", "requeue", job_of(out, 1))
        # Killed outright, as by the kernel when memory runs out.
        killed = wait_for_checkpoint(process, out, 2)
        os.kill(wait_until(process, lambda: trainer(out, 2), "a trainer"), signal.SIGKILL)
        # Signalled, as ahead of the time limit: it ends with a checkpoint and requeues itself.
        signalled = wait_for_checkpoint(process, out, 2, after=killed + 20)
        job = job_of(out, 2)
        slurm("scancel", "--signal=USR2", job)
        wait_until(process, lambda: 75 in [code for _, code in attempts(out, 2)], "a checkpoint")
        assert process.wait(300) == 0
    assert job_of(out, 2) == job
    assert [code for _, code in attempts(out, 1)][-1] == 0
    assert attempts(out, 1)[-1][0] >= first
    assert [code for _, code in attempts(out, 2)] == [-9, 75, 0]
    starts = [start for start, _ in attempts(out, 2)]
    assert starts[0] == 0 < killed <= starts[1] < signalled <= starts[2]
    assert_as_if_never_disturbed(whole, out)


def test_what_slurm_refuses_leaves_nothing_behind(tmp_path: Path) -> None:
    command = launch("slurm", tmp_path / "out", "--sbatch", "partition=nosuch")
    result = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert result.returncode == 2
    (line,) = result.stderr.splitlines()
    assert line.startswith("error: on: SLURM refuses the jobs: ")
    assert "invalid partition" in line
    assert not list(tmp_path.iterdir())


def test_a_launcher_that_is_stopped_leaves_its_jobs_and_takes_them_up_again(
    tmp_path: Path,
) -> None:
    out = tmp_path / "out"
    with begun(launch("slurm", out)) as process:
        wait_for_checkpoint(process, out, 1)
        process.send_signal(signal.SIGTERM)
        assert process.wait(60) == 75
    jobs = [job_of(out, part) for part in (1, 2)]
    # On a busy machine it would be done before the next launcher has begun.
    second = trainer(out, 2)
    assert second is not None
    os.kill(second, signal.SIGSTOP)
    with begun([*launch("slurm", out)[:3], "--resume", str(out)]) as process:
        wait_until(process, lambda: launches(out) == 2, "its beginning")
        time.sleep(3)  # in which it takes the jobs up
        slurm("scancel", jobs[1])  # by its user: that is not tried again
        os.kill(second, signal.SIGCONT)
        assert process.wait(300) == 75
    assert [job_of(out, part) for part in (1, 2)] == jobs
    assert attempts(out, 1) == [(0, 0)]
    with begun([*launch("slurm", out)[:3], "--resume", str(out)]) as process:
        assert process.wait(300) == 0
    assert len(attempts(out, 1)) == 2  # which finds the part done
    evaluation = [*launch("slurm", out)[:2], "cgm_jax.evaluate", str(out), "--episodes", "5"]
    result = subprocess.run(evaluation, cwd=ROOT, capture_output=True, text=True, check=False)
    assert len(result.stdout.splitlines()) == 4, result.stderr
