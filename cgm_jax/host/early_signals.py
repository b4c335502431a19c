"""Signals before a program listens for them itself (interruption.py), while it is being imported.

Python would raise KeyboardInterrupt wherever it stands, which prints a traceback, or is lost: some
modules catch everything while they are imported, and the program would train on. There is nothing
to lose yet, so that any signal ends the process at once.
"""

import itertools
import os
import re
import signal
import sys

STOPPED = 75
"""As in exit_codes.py; nothing is imported here that takes a moment."""

NAMES = ("SIGINT", "SIGTERM", "SIGHUP", "SIGUSR1", "SIGUSR2")


def end_on_early_signals() -> None:
    """Let signals end the process, if it was started as one of our programs.

    Of others, which import this package, signals are none of our business.
    """
    if not _is_ours():
        return
    for name in NAMES:
        number = getattr(signal, name, None)
        if number is not None and signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, lambda *_: os._exit(STOPPED))


def _is_ours() -> bool:
    """Whether Python is at this moment looking for `python -m cgm_jax.NAME`."""
    words = getattr(sys, "orig_argv", [])
    return getattr(sys, "argv", [])[:1] == ["-m"] and any(
        word == "-m" and re.fullmatch(r"cgm_jax\.\w+", after)
        for word, after in itertools.pairwise(words)
    )
