"""Answer questions of the report: `python -m experiments.run QUESTION [QUESTION ...]`.

Trains a question's sweeps (plans.toml) into runs/experiments/SWEEP, where each goes on from where
it stopped. What is done is then recorded in results/sweeps/SWEEP, and from those records come
tables and figures in results/QUESTION. `--draw` trains nothing and draws from what is on record.
"""

import argparse
import shlex
import sys
import tomllib
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
from matplotlib.figure import Figure

from cgm_jax.grid import Group, Run, build_groups
from cgm_jax.host.command_line import chosen_values, parse, seed_values
from cgm_jax.host.run_directory import RunDirectory
from cgm_jax.report.figures import epochs_to_half, learning_curves, mask_success
from cgm_jax.settings import Settings
from cgm_jax.sweep import SweepOptions
from experiments.learning.comparison import comparison
from experiments.learning.records import record, recorded_groups, recorded_rows
from experiments.learning.tables import improvement, learning_speed, write_table
from experiments.learning.train import train

HERE = Path(__file__).parent
PLANS = HERE / "plans.toml"
RUNS = Path("runs") / "experiments"
RESULTS = HERE / "results"
FIGURES = {
    "comparison": comparison,
    "learning_curves": learning_curves,
    "epochs_to_half": epochs_to_half,
    "mask_success": mask_success,
}


def planned_groups(options: str) -> list[Group]:
    """The runs that a sweep's options stand for."""
    parsed = parse(SweepOptions, shlex.split(options), "python -m cgm_jax.sweep")
    return build_groups(parsed.preset or "quick", seed_values(parsed, chosen_values(parsed)))


def planned_rows(sweep: str, options: str) -> list[dict[str, Any]]:
    """Rows of a sweep's runs that are on record."""
    recorded = recorded_groups(sweep)
    if recorded and _runs_of(recorded) != _runs_of(planned_groups(options)):
        sys.exit(f"{sweep}: on record are other runs than are planned now; train it again")
    return recorded_rows(sweep)


def _runs_of(groups: list[Group]) -> list[tuple[Settings, Run]]:
    """The same however groups are split."""
    return [(group.settings, run) for group in groups for run in group.runs]


def write_results(question: str, plan: dict[str, Any], sweeps: dict[str, str]) -> Path:
    """Write everything that the report shows for a question; `sweeps` are all sweeps' options."""
    rows = [row for sweep in plan["sweeps"] for row in planned_rows(sweep, sweeps[sweep])]
    if not rows:
        sys.exit(f"{question}: nothing trained yet")
    target = RESULTS / question
    target.mkdir(parents=True, exist_ok=True)
    write_table(target / "speed.csv", learning_speed(rows))
    if table := improvement(rows):
        write_table(target / "improvement.csv", table)
    for name in plan["figures"]:
        _save(FIGURES[name](rows), target / f"{name}.png")
    return target


def _save(figure: Figure, path: Path) -> None:
    figure.savefig(path, dpi=130)
    plt.close(figure)


def main() -> None:
    """Train and draw the questions named on the command line."""
    plans = tomllib.loads(PLANS.read_text())
    parser = argparse.ArgumentParser(prog="python -m experiments.run")
    parser.add_argument("questions", nargs="+", choices=list(plans["questions"]))
    parser.add_argument("--draw", action="store_true", help="train nothing, draw from the records")
    parser.add_argument(
        "--at-once",
        type=int,
        default=1,
        metavar="N",
        help="train N sweeps at a time, each on its share of the cores",
    )
    options = parser.parse_args()
    if options.at_once < 1:
        parser.error(f"--at-once: {options.at_once} is not at least 1")
    chosen = [plans["questions"][question] for question in options.questions]
    sweeps = {name: plans["sweeps"][name] for plan in chosen for name in plan["sweeps"]}
    if not options.draw:
        train(sweeps, RUNS, options.at_once)
    for sweep in sweeps:
        if RunDirectory(RUNS / sweep).holds_sweep():
            record(RunDirectory(RUNS / sweep), sweep)
    for question in options.questions:
        print(write_results(question, plans["questions"][question], plans["sweeps"]))


if __name__ == "__main__":
    main()
