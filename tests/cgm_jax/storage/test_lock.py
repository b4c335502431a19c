import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from cgm_jax.config.fields import SettingError
from cgm_jax.storage.lock import locked


def test_a_second_holder_is_refused_and_told_of_the_first(tmp_path: Path) -> None:
    refusal = re.escape(f"out: {tmp_path} is in use by process {os.getpid()} on ")
    with (
        locked(tmp_path / "lock"),
        pytest.raises(SettingError, match=refusal),
        locked(tmp_path / "lock"),
    ):
        pass
    with locked(tmp_path / "lock"):
        pass


def test_the_lock_of_a_killed_process_is_free(tmp_path: Path) -> None:
    path = tmp_path / "lock"
    program = (
        "import sys, time; from pathlib import Path; from cgm_jax.storage.lock import locked\n"
        "with locked(Path(sys.argv[1])): print('held', flush=True); time.sleep(60)"
    )
    command = [sys.executable, "-c", program, str(path)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "held\n"
        with pytest.raises(SettingError, match=f"process {process.pid} on"), locked(path):
            pass
        process.kill()
        process.wait()
    with locked(path):
        assert path.read_text().startswith(f"process {os.getpid()} on")


def test_a_lock_that_cannot_be_written_is_an_error_of_the_system(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError), locked(tmp_path / "nowhere" / "lock"):
        pass
