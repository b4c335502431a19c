"""What is left on a terminal once a sweep is done, or stopped."""

import contextlib
import os
import pty
import sys
import threading
import time
from collections.abc import Iterator
from fractions import Fraction
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


@contextlib.contextmanager
def terminal(monkeypatch: pytest.MonkeyPatch) -> Iterator[bytearray]:
    """A terminal on standard error; what is written to it."""
    for name, value in {"TERM": "xterm", "COLUMNS": "120", "LINES": "50"}.items():
        monkeypatch.setenv(name, value)
    ours, theirs = pty.openpty()
    written = bytearray()
    reader = threading.Thread(target=read_all, args=(ours, written))
    reader.start()
    with os.fdopen(theirs, "w") as screen, monkeypatch.context() as patched:
        patched.setattr(sys, "stderr", screen)
        yield written
    reader.join(timeout=60)
    os.close(ours)


@pytest.mark.parametrize(("done", "listed"), [(10, False), (9, True)])
def test_runs_stay_listed_only_where_no_summary_lists_them_again(
    done: int, listed: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    with terminal(monkeypatch) as written, SweepProgress(10) as progress:
        for _ in range(70 * done):  # floats would never add up to the whole
            progress.advance(Fraction(1, 70))
        progress.epoch(1, [{"run": name, "success_rate": 0.5} for name in NAMES])
    last = written.decode().rpartition("\x1b[2K")[2]  # after all that was erased
    assert f"{10 * done} %" in last
    assert all((name in last) is listed for name in NAMES)


def test_the_bar_says_compiling_before_anything_is_known_and_whenever_it_compiles_again(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    said: list[str] = []

    def say(written: bytearray, since: int) -> int:
        """What the bar shows last, once something has been drawn."""
        deadline = time.monotonic() + 30
        while b" %" not in written[since:] and time.monotonic() < deadline:
            time.sleep(0.02)
        text = written[since:].decode(errors="replace")
        said.append(max(("compiling", "training"), key=text.rfind))
        return len(written)

    with terminal(monkeypatch) as written, SweepProgress() as progress:
        since = say(written, 0)  # while JAX starts, and the environment is made
        progress.expect(10)
        progress.advance(5)
        since = say(written, since)
        progress.compiling()  # the next program
        say(written, since)
    assert said == ["compiling", "training", "compiling"]


def test_nothing_stays_of_the_bar_of_a_sweep_that_is_refused(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    refused = pytest.raises(ValueError, match="refused")
    with terminal(monkeypatch) as written, refused, SweepProgress():
        raise ValueError("refused")
    last = written.decode().rpartition("\x1b[2K")[2]
    assert "compiling" not in last


def test_lines_in_a_log_are_as_long_as_what_they_say(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "40")
    rows = [{"run": name, "success_rate": 0.5, "env_steps": 10**9} for name in NAMES]
    with SweepProgress() as progress:
        progress.expect(10)
        progress.epoch(1, rows)
        two = [{**row, "success_rate": rate} for row, rate in zip(rows, (0.2, 0.7), strict=False)]
        progress.epoch(2, two)
    with JointProgress({1: Path("none")}, {1: 10}) as joint:
        joint._next_line = 0.0
        joint.show([], 1)
    epoch, even, parts = capsys.readouterr().err.splitlines()
    assert epoch.startswith(
        "epoch 1: 1,000,000,000 environment steps, success median 50 % of 3 runs"
    )
    assert even.startswith(
        "epoch 2: 1,000,000,000 environment steps, success median 45 % of 2 runs (20 % to 70 %)"
    )
    assert parts.startswith("0 % of 10 epochs over all runs; 0 of 1 parts done, 1 running, 0 s")
