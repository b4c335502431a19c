"""Commands: what to type, and what a program was begun with."""

import shlex
import sys
from collections.abc import Sequence
from pathlib import Path


def begun_with(program: str, arguments: Sequence[str] | None) -> list[str]:
    """The command that does what a call of a program's `main` does.

    Args:
        program: the module, such as cgm_jax.sweep.
        arguments: of `main`; None for those of the command line.
    """
    return ["python", "-m", program, *(sys.argv[1:] if arguments is None else arguments)]


def shell_command(program: str, *arguments: str | Path) -> str:
    """A command line that runs a program of this package as it is, from any directory.

    Paths become absolute, everything is quoted, and the interpreter is the one that runs now.
    """
    words = [Path(word).absolute() if isinstance(word, Path) else word for word in arguments]
    interpreter = sys.executable or "python"
    return shlex.join([interpreter, "-m", program, *(str(word) for word in words)])
