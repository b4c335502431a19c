"""Signals to small programs that stand for a sweep at its several stages."""

import signal
import subprocess
import sys
import time

import pytest

PROGRAM = """
import hashlib, time
from cgm_jax.host.interruption import Interruption
with Interruption(patience={patience}) as interruption:
    interruption.expendable = {expendable}
    print("ready", flush=True)
    {work}
print("saved", interruption.requested, flush=True)
"""
# One call into C that no Python signal handler can interrupt, as a chunk of training is.
LONG_CALL = "hashlib.pbkdf2_hmac('sha256', b'', b'', 2**31 - 1)"
SHORT_CALLS = "while not interruption.requested: time.sleep(0.01)"


def signalled(
    work: str, *numbers: int, patience: float = 8.0, expendable: bool = False
) -> tuple[int, str, str, float]:
    """Exit code, stdout, stderr, and seconds from the first signal to the end."""
    program = PROGRAM.format(work=work, patience=patience, expendable=expendable)
    with subprocess.Popen(
        [sys.executable, "-c", program], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        assert process.stdout.readline() == "ready\n"
        began = time.monotonic()
        for number in numbers:
            process.send_signal(number)
            time.sleep(0.3)
        out, error = process.communicate(timeout=30)
        return process.returncode, out, error, time.monotonic() - began


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_asks_the_loop_to_stop_and_save(number: int) -> None:
    code, out, error, _ = signalled(SHORT_CALLS, number)
    assert (code, out) == (0, "saved True\n")
    assert error == "stopping after the running chunk; once more: at once\n"


def test_work_that_takes_too_long_is_ended() -> None:
    code, out, error, seconds = signalled(LONG_CALL, signal.SIGTERM, patience=1.0)
    assert (code, out) == (75, "")
    assert error.endswith("stopped at once; the last complete checkpoint stays\n")
    assert 1.0 <= seconds < 8.0


def test_a_second_signal_ends_at_once() -> None:
    code, out, _, seconds = signalled(LONG_CALL, signal.SIGINT, signal.SIGINT)
    assert (code, out) == (75, "")
    assert seconds < 7.0


def test_with_nothing_to_lose_the_first_signal_ends_at_once() -> None:
    code, out, _, seconds = signalled(LONG_CALL, signal.SIGTERM, expendable=True)
    assert (code, out) == (75, "")
    assert seconds < 7.0


def test_without_a_signal_nothing_happens() -> None:
    assert signalled("pass")[:3] == (0, "saved False\n", "")
