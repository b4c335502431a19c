"""Whether a sweep can be trained, before a launch makes anything.

    python -m cgm_jax.launching.check here|elsewhere SWEEP OPTIONS

A process of its own makes environments, agents and curricula, as its parts will: a launcher starts
no JAX. What depends on the machine, devices and memory, is only checked where parts train on this
one.
"""

import os
import subprocess
import sys
from collections.abc import Sequence

from cgm_jax.config.fields import SettingError
from cgm_jax.host.asked import asked_for
from cgm_jax.host.command_line import parse, run_program
from cgm_jax.host.devices import parse_devices
from cgm_jax.host.exit_codes import ExitCode
from cgm_jax.host.session import plan
from cgm_jax.results.tracking import find_tracker
from cgm_jax.sweep import SweepOptions

PROGRAM = "cgm_jax.launching.check"
HERE, ELSEWHERE = "here", "elsewhere"


def check_sweep(words: Sequence[str], *, here: bool) -> None:
    """Check a sweep in a process of its own.

    Args:
        words: options of the sweep, which name no code but what the user has named.
        here: whether this machine is to train it.

    Raises:
        SettingError: parts of it would be refused.
    """
    command = [sys.executable, "-m", PROGRAM, HERE if here else ELSEWHERE, *words]
    environment = os.environ if here else {**os.environ, "JAX_PLATFORMS": "cpu"}
    result = subprocess.run(
        command, env=environment, capture_output=True, text=True, errors="replace", check=False
    )
    if result.returncode != ExitCode.DONE:
        last = (result.stderr.splitlines() or [f"exit code {result.returncode}"])[-1]
        raise SettingError(last.removeprefix("error: "))


def main() -> int:
    """Check what the command line says; refuse it as `cgm_jax.sweep` would."""
    place, *words = sys.argv[1:]
    options = parse(SweepOptions, words, f"python -m {PROGRAM}")
    if options.track is not None:
        find_tracker(options.track)
    groups = asked_for(options).groups
    assert groups is not None  # only --resume asks for none, and belongs to the launch
    plan(groups, parse_devices(options.devices), on_this_machine=place == HERE)
    return ExitCode.DONE


if __name__ == "__main__":
    run_program(main)
