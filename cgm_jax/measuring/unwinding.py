"""What a program makes is removed again, also when a signal ends it."""

import contextlib
import signal
from collections.abc import Iterator
from contextlib import AbstractContextManager, ExitStack
from types import FrameType
from typing import Self, TypeVar

SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)

Resource = TypeVar("Resource")


class Unwinding:
    """The first signal raises KeyboardInterrupt in the block; later ones change nothing."""

    def __init__(self) -> None:
        self._shields = 0
        self._requested = False
        self._raised = False

    def __enter__(self) -> Self:
        heard = [number for number in SIGNALS if signal.getsignal(number) != signal.SIG_IGN]
        self._before = {number: signal.signal(number, self._handle) for number in heard}
        return self

    def __exit__(self, *_: object) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)

    @contextlib.contextmanager
    def held(self, resource: AbstractContextManager[Resource]) -> Iterator[Resource]:
        """Hold a resource; signals wait while it is made and while it is removed."""
        stack = ExitStack()
        try:
            with self._shield():
                value = stack.enter_context(resource)
            yield value
        finally:
            with self._shield():
                stack.close()

    @contextlib.contextmanager
    def _shield(self) -> Iterator[None]:
        self._shields += 1
        try:
            yield
        finally:
            self._shields -= 1
            self._raise_if_due()

    def _handle(self, number: int, frame: FrameType | None) -> None:
        self._requested = True
        self._raise_if_due()

    def _raise_if_due(self) -> None:
        if self._requested and not self._raised and not self._shields:
            self._raised = True
            raise KeyboardInterrupt
