"""One run of this program, with the preset `cpu`, on its own simulation of the task.

    python -m experiments.other_programs.our_run TASK SEED CPU_SECONDS OUT.csv

Half of the goals of pick-and-place are in the air, as in Gymnasium-Robotics.
"""

import os
import signal
import sys
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cgm_jax import train
from cgm_jax.host.exit_codes import ExitCode
from cgm_jax.results.trackers.protocol import Tracker
from experiments.other_programs.curve import add, begin, cpu_seconds

PATH, LIMIT = "CURVE_PATH", "CURVE_CPU_SECONDS"
"""Variables that tell the tracker where to write, and when to end."""


@dataclass
class Curve(Tracker):
    """Writes every evaluation, and ends training once the CPU seconds are used up."""

    def begin(self, run: str, settings: Mapping[str, Any], sent: int) -> int:
        """The table is begun already."""
        return sent

    def metrics(self, run: str, epoch: int, values: Mapping[str, float]) -> None:
        """Add an evaluation."""
        add(Path(os.environ[PATH]), int(values["env_steps"]), values["success_rate"])
        if cpu_seconds() > float(os.environ[LIMIT]):
            os.kill(os.getpid(), signal.SIGTERM)

    def files(self, run: str, epoch: int, paths: Mapping[str, Path]) -> None:
        """Show none."""

    def end(self, run: str) -> None:
        """All is written."""


def main(task: str, seed: int, limit: float, path: Path, preset: str = "cpu") -> int:
    """Train until the CPU seconds are used up, or for the preset's epochs; the exit code."""
    os.environ |= {PATH: str(path.resolve()), LIMIT: str(limit)}
    begin(path)
    options = ["--preset", preset, "--env", task, "--seed", str(seed)]
    if task == "pick_and_place":
        options += ["--air-probability", "0.5"]
    with tempfile.TemporaryDirectory() as directory:
        out = ["--out", str(Path(directory) / "run"), "--track", f"{__file__}:Curve"]
        code = train.main([*options, *out])
    used_up = code == ExitCode.STOPPED and cpu_seconds() > limit
    return ExitCode.DONE if used_up or code == ExitCode.DIVERGED else code


if __name__ == "__main__":
    if len(sys.argv) != 5:
        sys.exit(__doc__)
    sys.exit(main(sys.argv[1], int(sys.argv[2]), float(sys.argv[3]), Path(sys.argv[4])))
