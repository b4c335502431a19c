"""What is left on a terminal once a sweep is done, or stopped."""

import contextlib
import os
import pty
import sys
import threading
from pathlib import Path

import pytest

from cgm_jax.host.progress import SweepProgress
from cgm_jax.launching.progress import JointProgress

NAMES = [f"reach_cgm_seed{seed}" for seed in range(3)]


def read_all(terminal: int, into: bytearray) -> None:
    """Read until the other side is closed, which Linux reports as an error."""
    with contextlib.suppress(OSError):
        while part := os.read(terminal, 4096):
            into.extend(part)


@pytest.mark.parametrize(("done", "listed"), [(10, False), (9, True)])
def test_runs_stay_listed_only_where_no_summary_lists_them_again(
    done: int, listed: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, value in {"TERM": "xterm", "COLUMNS": "120", "LINES": "50"}.items():
        monkeypatch.setenv(name, value)
    terminal, process = pty.openpty()
    written = bytearray()
    reader = threading.Thread(target=read_all, args=(terminal, written))
    reader.start()
    with os.fdopen(process, "w") as screen, monkeypatch.context() as patched:
        patched.setattr(sys, "stderr", screen)
        with SweepProgress(10) as progress:
            progress.advance(done, env_steps=100, seconds=1.0)
            progress.epoch(1, [{"run": name, "success_rate": 0.5} for name in NAMES])
    reader.join(timeout=60)
    os.close(terminal)
    last = written.decode().rpartition("\x1b[2K")[2]  # after all that was erased
    assert f"{10 * done} %" in last
    assert all((name in last) is listed for name in NAMES)


def test_lines_in_a_log_are_as_long_as_what_they_say(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "40")
    rows = [{"run": name, "success_rate": 0.5, "env_steps": 10**9} for name in NAMES]
    with SweepProgress(10) as progress:
        progress.epoch(1, rows)
    with JointProgress({1: Path("none")}, {1: 10}) as joint:
        joint._next_line = 0.0
        joint.show([], 1)
    epoch, parts = capsys.readouterr().err.splitlines()
    assert epoch.startswith(
        "epoch 1: 1,000,000,000 environment steps, success median 50 % of 3 runs"
    )
    assert parts.startswith("0 % of 10 epochs over all runs; 0 of 1 parts done, 1 running, 0 s")
