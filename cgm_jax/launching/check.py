"""Whether a sweep can be trained, before a launch makes anything.

    python -m cgm_jax.launching.check here|elsewhere SWEEP OPTIONS

A process of its own makes environments, agents and curricula, as its parts will: a launcher starts
no JAX. What depends on the machine, devices and memory, is only checked where parts train on this
one.
"""

import os
import subprocess
import sys
from collections.abc import Mapping, Sequence

from cgm_jax.config.fields import SettingError
from cgm_jax.host.asked import asked_for
from cgm_jax.host.command_line import parse, run_program
from cgm_jax.host.devices import parse_devices
from cgm_jax.host.exit_codes import ExitCode
from cgm_jax.host.to_train import plan
from cgm_jax.results.tracking import find_tracker
from cgm_jax.sweep import SweepOptions

PROGRAM = "cgm_jax.launching.check"
HERE, ELSEWHERE = "here", "elsewhere"
PATIENCE_SECONDS = 300.0


def check_sweep(words: Sequence[str], part: Mapping[str, str] | None) -> None:
    """Check a sweep in a process of its own; if that cannot be done, say so and let it be.

    Args:
        words: options of the sweep, which name no code but what the user has named.
        part: variables of a part, if parts train on this machine.

    Raises:
        SettingError: parts of it would be refused.
    """
    environment = {**os.environ, **(part or {})}
    if part is None:  # whatever GPU this machine has or lacks is not the parts'
        environment["JAX_PLATFORMS"] = "cpu"
    command = [sys.executable, "-m", PROGRAM, ELSEWHERE if part is None else HERE, *words]
    try:
        result = subprocess.run(
            command,
            env=environment,
            capture_output=True,
            text=True,
            errors="replace",
            timeout=PATIENCE_SECONDS,
            check=False,
        )
    except subprocess.TimeoutExpired:
        print(f"not checked beforehand: it takes over {PATIENCE_SECONDS:.0f} s", file=sys.stderr)
        return
    lines = [line for line in result.stderr.splitlines() if line.startswith("error: ")]
    if result.returncode == ExitCode.BAD_INPUT and lines:
        raise SettingError(lines[-1].removeprefix("error: "))
    if result.returncode:
        print(f"not checked beforehand: exit code {result.returncode}", file=sys.stderr)


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
