"""One run of this program, with the preset `cpu`, on its own simulation of the task.

    python -m experiments.other_programs.our_run ARM TASK SEED CPU_SECONDS OUT.csv

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
from cgm_jax.storage.layout import METRICS
from experiments.other_programs.arms import OURS
from experiments.other_programs.curve import add, begin, cpu_seconds, is_wanted
from experiments.table import read_table

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
        if cpu_seconds() > float(os.environ[LIMIT]) or not is_wanted():
            os.kill(os.getpid(), signal.SIGTERM)

    def files(self, run: str, epoch: int, paths: Mapping[str, Path]) -> None:
        """Show none."""

    def end(self, run: str) -> None:
        """All is written."""


def main(arm: str, task: str, seed: int, limit: float, path: Path, preset: str = "cpu") -> int:
    """Train until the CPU seconds are used up, or for the preset's epochs; the exit code.

    Raises:
        RuntimeError: the curve lacks evaluations.
    """
    os.environ |= {PATH: str(path.resolve()), LIMIT: str(limit)}
    begin(path)
    options = ["--preset", preset, "--env", task, "--seed", str(seed), *OURS[arm][1]]
    if task == "pick_and_place":
        options += ["--air-probability", "0.5"]
    with tempfile.TemporaryDirectory() as directory:
        run = Path(directory) / "run"
        code = train.main([*options, "--out", str(run), "--track", f"{__file__}:Curve"])
        evaluations = len((run / METRICS).read_bytes().splitlines())
    if len(read_table(path)) != evaluations:  # training goes on without a tracker that fails
        raise RuntimeError(f"{path} has not all {evaluations} evaluations")
    used_up = code == ExitCode.STOPPED and cpu_seconds() > limit
    return ExitCode.DONE if used_up or code == ExitCode.DIVERGED else code


if __name__ == "__main__":
    if len(sys.argv) != 6:
        sys.exit(__doc__)
    _, arm, task, seed, limit, path = sys.argv
    sys.exit(main(arm, task, int(seed), float(limit), Path(path)))
