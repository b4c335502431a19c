"""Signals to small programs that hold something."""

import signal
import subprocess
import sys

import pytest

PROGRAM = """
import contextlib, time
from cgm_jax.measuring.unwinding import Unwinding

def say(text):
    print(text, flush=True)

@contextlib.contextmanager
def resource():
    say("making")
    time.sleep({making})
    say("made")
    try:
        yield
    finally:
        say("removing")
        time.sleep({removing})
        say("removed")

try:
    with Unwinding() as unwinding, unwinding.held(resource()):
        say("working")
        time.sleep({working})
        say("worked")
except KeyboardInterrupt:
    say("interrupted")
"""


def signalled(after: str, number: int, times: int = 1, **seconds: float) -> list[str]:
    """What the program says if it gets a signal once it has said `after`."""
    durations = {"making": 0.0, "working": 0.0, "removing": 0.0, **seconds}
    with subprocess.Popen(
        [sys.executable, "-c", PROGRAM.format(**durations)], stdout=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        said = []
        for line in process.stdout:
            said.append(line.strip())
            if said[-1] == after:
                for _ in range(times):
                    process.send_signal(number)
        assert process.wait(timeout=30) == 0
        return said


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_ends_the_work_and_what_was_made_is_removed(number: int) -> None:
    said = signalled("working", number, working=60)
    assert said == ["making", "made", "working", "removing", "removed", "interrupted"]


def test_what_is_being_made_is_made_first_and_then_removed() -> None:
    said = signalled("making", signal.SIGINT, making=1, working=60)
    assert said == ["making", "made", "removing", "removed", "interrupted"]


def test_what_is_being_removed_is_removed_first() -> None:
    said = signalled("removing", signal.SIGINT, removing=1)
    assert said[2:] == ["working", "worked", "removing", "removed", "interrupted"]


def test_further_signals_do_not_disturb_the_removal() -> None:
    said = signalled("working", signal.SIGTERM, times=5, working=60, removing=1)
    assert said == ["making", "made", "working", "removing", "removed", "interrupted"]
