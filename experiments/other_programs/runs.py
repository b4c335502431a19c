"""Runs of a comparison that are on record: OUT/runs.csv, and a curve of each."""

from pathlib import Path
from typing import NamedTuple

from experiments.table import read_table

RUNS = "runs.csv"


class Run(NamedTuple):
    """One curve."""

    arm: str
    task: str
    seed: int

    def path(self, out: Path) -> Path:
        """Where its curve is kept."""
        return out / "curves" / f"{self.arm}-{self.task}-{self.seed}.csv"

    def partial(self, out: Path) -> Path:
        """Where it is while it grows."""
        return self.path(out).with_suffix(".partial")


def runs_made(out: Path) -> list[Run]:
    """Runs whose curve is there, all with the same CPU seconds."""
    path = out / RUNS
    made = [
        Run(row["arm"], row["task"], int(row["seed"]))
        for row in (read_table(path) if path.exists() else [])
    ]
    return sorted(run for run in made if run.path(out).exists())
