"""Sweeps in processes of their own: started, stopped, killed, and compared."""

import json
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

from cgm_jax.measuring.training_process import process_times

ROOT = Path(__file__).parents[2]
POINT_MASS = f"{ROOT / 'tests/examples/point_mass.py'}:PointMass"


def command(*arguments: str) -> list[str]:
    return [sys.executable, "-m", "cgm_jax.sweep", "--preset", "smoke", *arguments]


def finish(arguments: list[str], code: int = 0) -> subprocess.CompletedProcess[str]:
    """Run to the end and check the exit code."""
    result = subprocess.run(
        arguments, capture_output=True, text=True, timeout=300, cwd=ROOT, check=False
    )
    assert result.returncode == code, result.stderr
    return result


def stop(
    arguments: list[str], after: str, number: int = signal.SIGTERM, cpu_s: float = 0.0
) -> tuple[int, str]:
    """Send a signal once a line on stderr starts with `after`; return exit code and stderr.

    It is sent after so many further CPU seconds.
    """
    with subprocess.Popen(arguments, stderr=subprocess.PIPE, text=True, cwd=ROOT) as process:
        assert process.stderr is not None
        seen = ""
        for line in process.stderr:
            seen += line
            if line.startswith(after):
                _let_compute(process.pid, cpu_s)
                process.send_signal(number)
                break
        seen += process.stderr.read()
        return process.wait(timeout=60), seen


def _let_compute(pid: int, cpu_s: float) -> None:
    state, now = process_times(pid)
    until = now + cpu_s
    while now < until and state != "Z":
        time.sleep(0.01)
        state, now = process_times(pid)


def rows(out: Path) -> list[dict[str, Any]]:
    """The rows of metrics.jsonl without the one field that depends on the machine."""
    lines = (out / "metrics.jsonl").read_text().splitlines()
    return [
        {name: value for name, value in json.loads(line).items() if name != "wall_s"}
        for line in lines
    ]


def final_state(out: Path, group: int = 0) -> dict[str, np.ndarray]:
    """All arrays of the last checkpoint but the times."""
    path = max((out / "checkpoints").glob(f"group{group}_*.npz"))
    arrays = _arrays(path)
    return {name: arrays[name] for name in arrays if name not in ("wall_s", "rows")}


def assert_same_results(one: Path, other: Path) -> None:
    """Metrics, whole training states and policies are equal bit for bit."""
    assert rows(one) == rows(other)
    _assert_same_arrays(final_state(one), final_state(other))
    policies = [sorted((out / "policies").rglob("*.npz")) for out in (one, other)]
    assert [path.name for path in policies[0]] == [path.name for path in policies[1]]
    for path, again in zip(*policies, strict=True):
        _assert_same_arrays(_arrays(path), _arrays(again))


def _arrays(path: Path) -> dict[str, np.ndarray]:
    with np.load(path, allow_pickle=False) as file:
        return {name: file[name] for name in file.files}


def _assert_same_arrays(one: dict[str, np.ndarray], other: dict[str, np.ndarray]) -> None:
    assert set(one) == set(other)
    for name, array in one.items():
        assert array.shape == other[name].shape, name
        assert array.tobytes() == other[name].tobytes(), name
