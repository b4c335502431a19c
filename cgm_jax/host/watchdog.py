"""If nothing happens for long, print where every thread stands. Nothing is ended."""

import contextlib
import faulthandler
import io
import sys
from collections.abc import Callable, Iterator

QUIET_SECONDS = 600.0
"""Longer than any compilation or chunk that goes well."""


@contextlib.contextmanager
def watchdog(seconds: float = QUIET_SECONDS) -> Iterator[Callable[[], None]]:
    """Watch the block, which calls what it is given whenever something has happened.

    Python's own `faulthandler` prints the stacks, to standard error, again after every
    `seconds` of silence, and even where a library holds Python's lock.
    """
    try:
        stream = sys.stderr.fileno()
    except (AttributeError, io.UnsupportedOperation):  # replaced by something without a file
        yield lambda: None
        return

    def something_happened() -> None:
        faulthandler.dump_traceback_later(seconds, repeat=True, file=stream)

    something_happened()
    try:
        yield something_happened
    finally:
        faulthandler.cancel_dump_traceback_later()
