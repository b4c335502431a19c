"""One sweep per directory, on systems with and without locks."""

import errno
import fcntl
import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from cgm_jax.storage.lock import InUseError, locked
from tests.cgm_jax.sweeps import ROOT

HOLD = (
    "import sys, time; from pathlib import Path; from cgm_jax.storage.lock import locked\n"
    "with locked(Path(sys.argv[1])): print('held', flush=True); time.sleep(60)"
)


def test_a_second_holder_is_refused_and_told_of_the_first(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SLURM_JOB_ID", "4711")
    holder = re.escape(f"{tmp_path} is in use by SLURM job 4711, process {os.getpid()} on ")
    with (
        locked(tmp_path),
        pytest.raises(InUseError, match=holder + ".*; try again later$"),
        locked(tmp_path),
    ):
        pass
    with locked(tmp_path):
        pass


def no_flock(*_: Any) -> None:
    raise OSError(errno.ENOLCK, "No locks available")


@pytest.mark.parametrize("has_locks", [True, False])
def test_the_lock_of_a_killed_process_is_free(has_locks: bool, tmp_path: Path) -> None:
    without = "import errno, fcntl\ndef no(*_): raise OSError(errno.ENOLCK, '')\nfcntl.flock = no\n"
    program = HOLD if has_locks else without + HOLD
    command = [sys.executable, "-c", program, str(tmp_path)]
    with (
        pytest.MonkeyPatch.context() as patch,
        subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd=ROOT) as process,
    ):
        if not has_locks:
            patch.setattr(fcntl, "flock", no_flock)
        assert process.stdout is not None
        assert process.stdout.readline() == "held\n"
        with pytest.raises(InUseError, match=f"process {process.pid} on"), locked(tmp_path):
            pass
        process.kill()
        process.wait()
        with locked(tmp_path):
            holder = (tmp_path / "holder").read_text()
            assert holder.startswith(f"process {os.getpid()} on")


def test_a_lock_that_cannot_be_written_is_an_error_of_the_system(tmp_path: Path) -> None:
    file = tmp_path / "file"
    file.touch()
    with pytest.raises(OSError, match=str(file)), locked(file):
        pass
