"""What programs write to may break in any way: the work continues, and the exit code stays."""

import os
import pty
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest

from tests.cgm_jax.sweeps import ROOT

PROGRAM = """
import sys
{before}
from cgm_jax.host.command_line import run_program

def main():
    with open(sys.argv[1], "w") as file:
        for number in range(3000):
            print("\\N{{GREEK SMALL LETTER KAPPA}}", "x" * 80, file=sys.stderr)
            if {prints}:
                print("y" * 80)
        file.write("done")
    return 3

run_program(main)
"""
WITHOUT_POLL = "import select\ndel select.poll"


def run(
    done: Path,
    *,
    before: str = "",
    prints: bool = True,
    shell: Sequence[str] = (),
    **streams: Any,
) -> tuple[int, str, float]:
    """Exit code, what the program has written to its own file, and how long it took."""
    command = [
        *shell,
        sys.executable,
        "-c",
        PROGRAM.format(before=before, prints=prints),
        str(done),
    ]
    began = time.monotonic()
    with subprocess.Popen(command, cwd=ROOT, **streams) as process:
        if process.stdout is not None:
            process.stdout.close()
        try:
            code = process.wait(timeout=60)
        finally:
            process.kill()
    return code, done.read_text(), time.monotonic() - began


@pytest.mark.parametrize("before", ["", WITHOUT_POLL])
def test_a_reader_that_goes_away_costs_nothing(before: str, tmp_path: Path) -> None:
    streams: dict[str, Any] = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT}
    assert run(tmp_path / "done", before=before, **streams)[:2] == (3, "done")


@pytest.mark.parametrize("closed", [">&-", "2>&-", "<&- >&- 2>&-"])
def test_descriptors_that_are_closed_do_not_become_files(closed: str, tmp_path: Path) -> None:
    null = subprocess.DEVNULL
    shell = ("sh", "-c", f'exec "$@" {closed}', "sh")
    assert run(tmp_path / "done", shell=shell, stdout=null, stderr=null)[:2] == (3, "done")


def test_a_full_disk_behind_the_output_costs_nothing(tmp_path: Path) -> None:
    with Path("/dev/full").open("w") as full:
        assert run(tmp_path / "done", stdout=full, stderr=full)[:2] == (3, "done")


def test_a_reader_that_stops_reading_does_not_hold_up_the_work(tmp_path: Path) -> None:
    reading, writing = os.pipe()  # 64 KiB, which nobody takes
    try:
        code, text, seconds = run(tmp_path / "done", prints=False, stderr=writing)
    finally:
        os.close(reading)
        os.close(writing)
    assert (code, text) == (3, "done")
    assert seconds < 30  # 3000 waits would be 6000


def test_a_closed_terminal_costs_nothing(tmp_path: Path) -> None:
    master, terminal = pty.openpty()
    os.close(master)
    assert run(tmp_path / "done", stdout=terminal, stderr=terminal)[:2] == (3, "done")
    os.close(terminal)


def test_whole_output_arrives_in_any_encoding(tmp_path: Path) -> None:
    with (tmp_path / "output").open("wb") as file:
        environment = {**os.environ, "PYTHONIOENCODING": "ascii", "LANG": "C"}
        run(tmp_path / "done", stdout=subprocess.DEVNULL, stderr=file, env=environment)
    expected = f"\\u03ba {'x' * 80}\n" * 3000
    assert (tmp_path / "output").read_text() == expected


PROGRESS = """
import os, time
from cgm_jax.host.interruption import Interruption
from cgm_jax.host.progress import SweepProgress
with Interruption(), SweepProgress(10) as progress:
    row = {"run": "a" * 100, "success_rate": 0.5, "env_steps": 10**9}
    progress.advance(1)
    progress.show_speed(100, 1.0)
    progress.epoch(1, [row])
    time.sleep(1)  # until it is drawn
    os.write(1, b"ready\\n")
    time.sleep(60)
"""


def output_of_progress(number: int, on_terminal: bool) -> tuple[int, str]:
    """What progress writes until a signal comes."""
    reading, writing = pty.openpty() if on_terminal else os.pipe()
    process = subprocess.Popen(
        [sys.executable, "-c", PROGRESS],
        stdout=subprocess.PIPE,
        stderr=writing,
        cwd=ROOT,
        env={**os.environ, "TERM": "xterm", "FORCE_COLOR": "1", "COLUMNS": "50"},
    )
    os.close(writing)
    assert process.stdout is not None
    assert process.stdout.readline() == b"ready\n"
    process.send_signal(number)
    code, text = process.wait(timeout=30), b""
    while True:
        try:
            piece = os.read(reading, 10_000)
        except OSError:  # a terminal without a writer
            piece = b""
        if not piece:
            os.close(reading)
            process.stdout.close()
            return code, text.decode()
        text += piece


def test_the_cursor_is_never_hidden_and_lines_do_not_wrap() -> None:
    for number, code in ((2, 75), (9, -9)):
        actual, text = output_of_progress(number, on_terminal=True)
        assert actual == code
        assert "\x1b[?25" not in text
        assert "training" in text
    code, text = output_of_progress(2, on_terminal=False)
    assert code == 75
    first, last = text.splitlines()
    assert first.startswith("epoch 1: 1,000,000,000 environment steps, success 50 %, ")
    assert len(first) > 50
    assert last == "stopped at once"
    assert "\x1b" not in text
