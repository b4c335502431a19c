"""Commands to be typed as they are printed."""

import shlex
import sys
from pathlib import Path


def shell_command(program: str, *arguments: str | Path) -> str:
    """A command line that runs a program of this package as it is, from any directory.

    Paths become absolute, everything is quoted, and the interpreter is the one that runs now.
    """
    words = [Path(word).absolute() if isinstance(word, Path) else word for word in arguments]
    interpreter = sys.executable or "python"
    return shlex.join([interpreter, "-m", program, *(str(word) for word in words)])
