"""Ctrl-C and SIGTERM: stop soon, with a checkpoint, and never later than ten seconds.

A chunk of training runs in C++ and cannot be cut short, and Python runs its signal handlers
only between steps of its own. So a thread listens: it asks the host loop to stop after the
running chunk, and ends the process itself if that takes too long, if the signal is repeated,
or if there is nothing to lose. Ending so is as safe as `kill -9`: the last complete checkpoint
stays.
"""

import contextlib
import os
import select
import signal
import socket
import sys
import threading
from collections.abc import Callable
from types import TracebackType
from typing import NoReturn, Self

from cgm_jax.host.exit_codes import ExitCode

PATIENCE_SECONDS = 8.0
"""From a signal to the end of the process, at most."""

SIGNALS = (signal.SIGINT, signal.SIGTERM)
SHOW_CURSOR = "\x1b[?25h"


class Interruption:
    """Listens for signals while its block runs.

    Attributes:
        requested: whether to stop at the next opportunity.
        expendable: whether what the process is doing is not worth waiting for; then a signal
            ends it at once.
    """

    def __init__(self, patience: float = PATIENCE_SECONDS) -> None:
        self.requested = False
        self._patience = patience
        self.expendable = True
        self._ours, self._theirs = socket.socketpair()
        self._before: dict[int, Callable[..., object] | int | None] = {}
        self._thread = threading.Thread(target=self._listen, name="signals", daemon=True)

    def __enter__(self) -> Self:
        self._theirs.setblocking(False)
        self._wakeup = signal.set_wakeup_fd(self._theirs.fileno(), warn_on_full_buffer=False)
        for number in SIGNALS:
            self._before[number] = signal.signal(number, lambda *_: None)
        self._thread.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)
        signal.set_wakeup_fd(self._wakeup)
        self._theirs.close()  # ends the thread
        self._thread.join()
        self._ours.close()

    def _listen(self) -> None:
        if not self._wait(None):
            return
        self.requested = True
        if not self.expendable:
            _say("stopping after the running chunk; once more: at once")
            if not self._wait(self._patience):
                return
        _end()

    def _wait(self, seconds: float | None) -> bool:
        """Wait for a signal; False if the block has ended. The end of the time counts as one."""
        while select.select([self._ours], [], [], seconds)[0]:
            received = self._ours.recv(1)
            if not received:
                return False
            if received[0] in SIGNALS:
                return True
        return True


def _end() -> NoReturn:
    """End the process now, whatever its other threads are doing."""
    if sys.stderr.isatty():
        _say(SHOW_CURSOR, end="")
    _say("stopped at once; the last complete checkpoint stays")
    os._exit(ExitCode.STOPPED)


def _say(text: str, end: str = "\n") -> None:
    """Print to standard error, which may be closed already."""
    with contextlib.suppress(OSError, ValueError):
        print(text, end=end, file=sys.stderr, flush=True)
