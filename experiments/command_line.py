"""The command line of a program that takes nothing but paths."""

import argparse
from pathlib import Path


def paths(program: str, description: str | None, *names: str) -> list[Path]:
    """The paths that a program was given, in the order of their names; `--help` describes it.

    Args:
        program: the module's name.
        description: its docstring.
        names: what each path is called in the help; a `recording` is a file that must be there.
    """
    parser = argparse.ArgumentParser(
        prog=f"python -m {program}",
        description=description,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    for name in names:
        parser.add_argument(name, metavar=name.upper(), type=Path)
    given = vars(parser.parse_args())
    if "recording" in given and not given["recording"].is_file():
        parser.error(f"recording: there is no file {given['recording']}")
    return list(given.values())
