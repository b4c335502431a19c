"""A program in a process of its own, whose output is a measurement."""

import os
import subprocess
from collections.abc import Collection, Mapping, Sequence

from cgm_jax.host.exit_codes import ExitCode


class MeasurementError(Exception):
    """Something could not be measured; the message says what and why."""


def output_of(
    command: Sequence[str],
    variables: Mapping[str, str] | None = None,
    accepted: Collection[int] = (ExitCode.DONE,),
) -> str:
    """What a command prints.

    Args:
        command: its words.
        variables: of its environment, beside those of this process.
        accepted: exit codes of one that has done what it was to do.

    Raises:
        MeasurementError: it ends with another; the last line of what it said of it.
    """
    ended = subprocess.run(
        command,
        env={**os.environ, **(variables or {})},
        capture_output=True,
        text=True,
        check=False,
    )
    if ended.returncode not in accepted:
        said = last_line(ended.stderr) or f"exit code {ended.returncode}"
        raise MeasurementError(said.removeprefix("error: "))
    return ended.stdout


def last_line(text: str) -> str:
    """The last line that holds anything; empty if there is none."""
    return "".join(text.strip().splitlines()[-1:])
