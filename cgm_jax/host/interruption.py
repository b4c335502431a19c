"""Signals: stop soon, with a checkpoint, and never later than ten seconds.

Ctrl-C, SIGTERM, a closed terminal (SIGHUP), and the warnings of batch systems (SIGUSR1, SIGUSR2)
all ask for the same. Batch systems warn and then send SIGTERM, so that only a repeated Ctrl-C
means "at once".

A chunk of training runs in C++ and cannot be cut short, and Python runs its signal handlers
only between steps of its own. So a thread listens: it asks the host loop to stop after the
running chunk, and ends the process itself if that takes too long, if Ctrl-C is repeated, or if
there is nothing to lose. Ending so is as safe as `kill -9`: the last complete checkpoint stays.

Inside somebody else's program, such as a notebook, the process is never ended: a repeated Ctrl-C
raises KeyboardInterrupt there. Outside the main thread, signals are not this module's business.
"""

import contextlib
import os
import select
import signal
import socket
import sys
import threading
import time
from collections.abc import Callable
from typing import NoReturn, Self

from cgm_jax.host.exit_codes import ExitCode
from cgm_jax.host.streams import write_directly

PATIENCE_SECONDS = 8.0
"""From a signal to the end of the process, at most."""

STOPPING = "stopping after the running chunk; a second Ctrl-C: at once"
STOPPED_AT_ONCE = "stopped at once"

_ALWAYS = ("SIGINT", "SIGTERM")
_UNLESS_IGNORED = ("SIGHUP", "SIGUSR1", "SIGUSR2")
"""Signals that whoever started the program may have it ignore, as `nohup` does."""


class Interruption:
    """Listens for signals while its block runs.

    Attributes:
        requested: whether to stop at the next opportunity.
        expendable: whether what the process is doing is not worth waiting for; then a signal
            ends it at once.
        last_words: printed if the process is ended; None for nothing. May be set anew.
    """

    def __init__(
        self,
        patience: float = PATIENCE_SECONDS,
        *,
        ends_process: bool = True,
        first_words: str = STOPPING,
        last_words: str = STOPPED_AT_ONCE,
    ) -> None:
        """Listen, once the block is entered.

        Args:
            patience: seconds from the first signal to the end of the process.
            ends_process: whether this process is ours to end.
            first_words: printed if it is to stop soon.
            last_words: printed if it is ended.
        """
        self.requested = False
        self.expendable = True
        self._patience = patience
        self._ends_process = ends_process
        self._first_words = first_words
        self.last_words: str | None = last_words
        self._interrupts = 0
        self._before: dict[int, Callable[..., object] | int | None] = {}
        self._thread: threading.Thread | None = None

    def __enter__(self) -> Self:
        if threading.current_thread() is not threading.main_thread():
            return self
        if self._ends_process:
            self._listen_in_thread()
        for number in _signals():
            self._before[number] = signal.signal(number, self._handle)
        return self

    def __exit__(self, *_: object) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)
        if self._thread is not None:
            signal.set_wakeup_fd(self._wakeup)
            self._theirs.close()  # ends the thread
            self._thread.join()
            self._ours.close()

    def _handle(self, number: int, _: object) -> None:
        """Python's own signal handler, for processes that are not ours to end."""
        if self._ends_process:
            return
        self.requested = True
        self._interrupts += number == signal.SIGINT
        if number == signal.SIGINT and (self.expendable or self._interrupts > 1):
            raise KeyboardInterrupt

    def _listen_in_thread(self) -> None:
        self._ours, self._theirs = socket.socketpair()
        self._theirs.setblocking(False)
        self._wakeup = signal.set_wakeup_fd(self._theirs.fileno(), warn_on_full_buffer=False)
        self._thread = threading.Thread(target=self._listen, name="signals", daemon=True)
        self._thread.start()

    def _listen(self) -> None:
        numbers, deadline = _signals(), None
        while select.select([self._ours], [], [], _seconds_until(deadline))[0]:
            received = self._ours.recv(1)
            if not received:
                return  # the block has ended
            if received[0] not in numbers:
                continue
            self._interrupts += received[0] == signal.SIGINT
            if self.expendable or self._interrupts > 1:
                self._end()
            if deadline is None:
                self.requested = True
                deadline = time.monotonic() + self._patience
                with contextlib.suppress(OSError, ValueError):  # standard error may be closed
                    print(self._first_words, file=sys.stderr, flush=True)
        self._end()

    def _end(self) -> NoReturn:
        """End the process now, whatever its other threads are doing."""
        if self.last_words is not None:
            on_terminal = os.isatty(2)  # whose cursor may stand at the end of a progress bar
            write_directly(("\n" if on_terminal else "") + self.last_words + "\n")
        os._exit(ExitCode.STOPPED)


def _signals() -> list[int]:
    """Numbers of the signals to listen for; some systems have only two of them."""
    numbers = [getattr(signal, name, None) for name in _ALWAYS]
    for name in _UNLESS_IGNORED:
        number = getattr(signal, name, None)
        if number is not None and signal.getsignal(number) is not signal.SIG_IGN:
            numbers.append(number)
    return [int(number) for number in numbers if number is not None]


def _seconds_until(deadline: float | None) -> float | None:
    return None if deadline is None else max(0.0, deadline - time.monotonic())
