"""Signals to small programs that stand for a sweep at its several stages."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tests.cgm_jax.sweeps import ROOT

PROGRAM = """
import hashlib, signal, time
from cgm_jax.host.interruption import Interruption
{before}
with Interruption(patience={patience}, ends_process={ends_process}) as interruption:
    interruption.expendable = {expendable}
    print("ready", flush=True)
    {work}
print("saved", interruption.requested, flush=True)
"""
# One call into C that no Python signal handler can interrupt, as a chunk of training is.
LONG_CALL = "hashlib.pbkdf2_hmac('sha256', b'', b'', 2**31 - 1)"
SHORT_CALLS = "while not interruption.requested: time.sleep(0.01)"
SAVING = f"{SHORT_CALLS}\n    time.sleep(1.5)"
WARNINGS = [signal.SIGTERM, signal.SIGHUP, signal.SIGUSR1, signal.SIGUSR2]
STOPPING = "stopping after the running chunk; a second Ctrl-C: at once\n"


def signalled(
    work: str,
    *numbers: int,
    patience: float = 8.0,
    expendable: bool = False,
    ends_process: bool = True,
    before: str = "",
) -> tuple[int, str, str, float]:
    """Exit code, stdout, stderr, and seconds from the first signal to the end."""
    program = PROGRAM.format(
        work=work,
        patience=patience,
        expendable=expendable,
        ends_process=ends_process,
        before=before,
    )
    with subprocess.Popen(
        [sys.executable, "-c", program],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        bufsize=0,  # what is read ahead of the first line, `communicate` would not see
        cwd=ROOT,
    ) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == b"ready\n"
        began = time.monotonic()
        for number in numbers:
            process.send_signal(number)
            time.sleep(0.3)
        out, error = process.communicate(timeout=30)
        return process.returncode, out.decode(), error.decode(), time.monotonic() - began


@pytest.mark.parametrize("number", [signal.SIGINT, *WARNINGS])
def test_a_signal_asks_the_loop_to_stop_and_save(number: int) -> None:
    code, out, error, _ = signalled(SHORT_CALLS, number)
    assert (code, out) == (0, "saved True\n")
    assert error == STOPPING


def test_warnings_of_batch_systems_do_not_cut_the_patience() -> None:
    numbers = (signal.SIGUSR1, signal.SIGTERM, signal.SIGTERM, signal.SIGINT)
    code, out, error, _ = signalled(SAVING, *numbers)
    assert (code, out, error) == (0, "saved True\n", STOPPING)


def test_what_the_starter_ignores_stays_ignored() -> None:  # as nohup does
    ignore = "signal.signal(signal.SIGHUP, signal.SIG_IGN)"
    code, out, error, _ = signalled("time.sleep(1)", signal.SIGHUP, before=ignore)
    assert (code, out, error) == (0, "saved False\n", "")


def test_work_that_takes_too_long_is_ended() -> None:
    code, out, error, seconds = signalled(LONG_CALL, signal.SIGTERM, patience=0.3)
    assert (code, out) == (75, "")
    assert error.endswith("stopped at once\n")
    assert 0.3 <= seconds < 7.0


def test_a_second_ctrl_c_ends_at_once() -> None:
    code, out, _, seconds = signalled(LONG_CALL, signal.SIGINT, signal.SIGINT)
    assert (code, out) == (75, "")
    assert seconds < 7.0


def test_with_nothing_to_lose_the_first_signal_ends_at_once() -> None:
    code, out, _, seconds = signalled(LONG_CALL, signal.SIGTERM, expendable=True)
    assert (code, out) == (75, "")
    assert seconds < 7.0


def test_inside_somebody_elses_program_nothing_is_ended() -> None:
    code, out, error, _ = signalled(
        SAVING, signal.SIGTERM, signal.SIGTERM, patience=0.1, expendable=True, ends_process=False
    )
    assert (code, out, error) == (0, "saved True\n", "")
    code, out, error, _ = signalled(
        "time.sleep(60)", signal.SIGINT, expendable=True, ends_process=False
    )
    assert error.endswith("KeyboardInterrupt\n")
    assert (code, out) == (-signal.SIGINT, "")


CAREFREE_IMPORT = """
import os, signal, sys
class Finder:
    def find_spec(self, name, path=None, target=None):
        if name == "gymnasium":  # the first import that takes a moment
            try:
                os.kill(os.getpid(), int(os.environ["NUMBER"]))
                sum(range(10**5))
            except BaseException:
                pass
if os.environ.get("IGNORED"):
    signal.signal(int(os.environ["NUMBER"]), signal.SIG_IGN)
sys.meta_path.insert(0, Finder())
"""


@pytest.mark.parametrize(
    ("number", "ignored"),
    [
        *((number, False) for number in (signal.SIGINT, *WARNINGS)),
        *((number, True) for number in (signal.SIGINT, signal.SIGHUP)),
    ],
)
def test_a_signal_during_imports_ends_the_program_and_is_not_lost(
    number: int, ignored: bool, tmp_path: Path
) -> None:
    (tmp_path / "sitecustomize.py").write_text(CAREFREE_IMPORT)
    result = subprocess.run(
        [sys.executable, "-m", "cgm_jax.export", "--help"],
        capture_output=True,
        text=True,
        env={
            "PATH": os.environ["PATH"],
            "PYTHONPATH": f"{tmp_path}:{ROOT}",
            "NUMBER": str(int(number)),
            "IGNORED": "1" if ignored else "",
        },
        check=False,
    )
    assert (result.returncode, result.stderr) == (0 if ignored else 75, "")
    assert bool(result.stdout) is ignored


def test_signals_of_somebody_elses_program_are_left_alone() -> None:
    program = "import signal, cgm_jax; print(signal.getsignal(signal.SIGTERM) is signal.SIG_DFL)"
    result = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, cwd=ROOT, check=False
    )
    assert result.stdout == "True\n"


def test_without_a_signal_nothing_happens() -> None:
    assert signalled("pass")[:3] == (0, "saved False\n", "")
