"""Copy what is worth keeping of a sweep: `python experiments/collect.py RUN_DIR RESULT_DIR`.

Keeps config.json and the figures, and boils metrics.jsonl down to learning.csv.
"""

import csv
import shutil
import sys
from pathlib import Path

from cgm_jax.figures import draw_figures
from cgm_jax.run_directory import CONFIG, RunDirectory

COLUMNS = [
    "run",
    "env",
    "seed",
    "c_g",
    "kappa",
    "her",
    "cgm",
    "epoch",
    "env_steps",
    "updates",
    "wall_s",
    "success_rate",
]


def collect(source: Path, target: Path) -> None:
    """Copy from a run directory to a result directory, drawing the figures anew."""
    directory = RunDirectory.open(source)
    target.mkdir(parents=True, exist_ok=True)
    shutil.copy(source / CONFIG, target / CONFIG)
    for figure in draw_figures(directory):
        shutil.copy(figure, target / figure.name)
    with (target / "learning.csv").open("w", newline="") as file:
        writer = csv.DictWriter(file, COLUMNS, extrasaction="ignore", lineterminator="\n")
        writer.writeheader()
        writer.writerows(directory.metrics())


if __name__ == "__main__":
    if len(sys.argv) != 3:
        sys.exit(__doc__)
    collect(Path(sys.argv[1]), Path(sys.argv[2]))
