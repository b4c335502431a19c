"""What stands in for a function of the system that fails."""

import os
from collections.abc import Callable
from typing import Any, NoReturn


def refusing(number: int) -> Callable[..., NoReturn]:
    """A function of any arguments that raises the system's error of a number (`errno`)."""

    def refuse(*_: Any, **__: Any) -> NoReturn:
        raise OSError(number, os.strerror(number))

    return refuse
