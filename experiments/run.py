"""Answer questions of the report: `python -m experiments.run QUESTION [QUESTION ...]`.

Trains a question's sweeps (plans.toml) into runs/experiments/SWEEP, where each goes on from where
it stopped, and then writes results/QUESTION/: the configs of its sweeps, learning.csv, tables and
figures. `--draw` leaves the training out and makes do with what has been trained so far.
"""

import argparse
import json
import shlex
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
from matplotlib.figure import Figure

from cgm_jax.grid import Group, Run, build_groups
from cgm_jax.host.command_line import chosen_values, parse, seed_values
from cgm_jax.host.run_directory import CONFIG, RunDirectory
from cgm_jax.report.figures import epochs_to_half, learning_curves, mask_success
from cgm_jax.settings import Settings
from cgm_jax.statistics import holds
from cgm_jax.sweep import SweepOptions
from experiments.comparison import comparison
from experiments.tables import improvement, learning_speed, write_table

HERE = Path(__file__).parent
PLANS = HERE / "plans.toml"
RUNS = Path("runs") / "experiments"
RESULTS = HERE / "results"
COLUMNS = (
    *("sweep", "run", "env", "seed", "c_g", "kappa", "her", "cgm", "factorised", "epoch"),
    *("env_steps", "updates", "wall_s", "success_rate", "physics_warnings"),
)
FIGURES = {
    "comparison": comparison,
    "learning_curves": learning_curves,
    "epochs_to_half": epochs_to_half,
    "mask_success": mask_success,
}


def train(sweep: str, options: str) -> None:
    """Train a sweep, or what is missing of it; a stopped one ends this program as it ended."""
    command = [sys.executable, "-m", "cgm_jax.sweep", *shlex.split(options)]
    code = subprocess.run([*command, "--out", str(RUNS / sweep)], check=False).returncode
    if code != 0:
        sys.exit(code)


def trained_rows(sweep: str, options: str) -> list[dict[str, Any]]:
    """Metrics of a sweep's runs that are done, with what a comparison needs besides."""
    if not (RUNS / sweep / CONFIG).is_file():
        return []
    directory = RunDirectory.open(RUNS / sweep)
    if _runs_of(directory.groups()) != _runs_of(planned_groups(options)):
        sys.exit(f"{sweep}: {directory.path} holds other runs than are planned now; delete it")
    rows = directory.metrics()
    done = {
        run.name: {
            "sweep": sweep,
            "factorised": run.hyper.factorised,
            "alone": len(group.runs) == 1,
            "leave_at": group.settings.leave_at,
        }
        for group in directory.groups()
        for run in group.runs
        if is_done([row for row in rows if row["run"] == run.name], group.settings)
    }
    return [{**done[row["run"]], **row} for row in rows if row["run"] in done]


def planned_groups(options: str) -> list[Group]:
    """The runs that a sweep's options stand for."""
    parsed = parse(SweepOptions, shlex.split(options), "python -m cgm_jax.sweep")
    return build_groups(parsed.preset or "quick", seed_values(parsed, chosen_values(parsed)))


def _runs_of(groups: list[Group]) -> list[tuple[Settings, Run]]:
    """The same however groups are split."""
    return [(group.settings, run) for group in groups for run in group.runs]


def is_done(rows: list[dict[str, Any]], settings: Settings) -> bool:
    """Whether a run got to its last epoch, or holds the success at which it may leave."""
    if not rows:
        return False
    if rows[-1]["epoch"] == settings.epochs:
        return True
    rates = [row["success_rate"] for row in rows]
    return settings.leave_at is not None and holds(rates, settings.leave_at)


def write_results(question: str, plan: dict[str, Any], sweeps: dict[str, str]) -> Path:
    """Write everything that the report shows for a question; `sweeps` are all sweeps' options."""
    target = RESULTS / question
    target.mkdir(parents=True, exist_ok=True)
    rows = [row for sweep in plan["sweeps"] for row in trained_rows(sweep, sweeps[sweep])]
    if not rows:
        sys.exit(f"{question}: nothing trained yet")
    for sweep in plan["sweeps"]:
        if (RUNS / sweep / CONFIG).is_file():
            config = json.loads((RUNS / sweep / CONFIG).read_text())
            (target / f"{sweep}.json").write_text(json.dumps(config, indent=1) + "\n")
    write_table(target / "learning.csv", [{name: row[name] for name in COLUMNS} for row in rows])
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
    parser.add_argument("--draw", action="store_true", help="draw what there is, train nothing")
    options = parser.parse_args()
    for question in options.questions:
        plan = plans["questions"][question]
        for sweep in [] if options.draw else plan["sweeps"]:
            train(sweep, plans["sweeps"][sweep])
        print(write_results(question, plan, plans["sweeps"]))


if __name__ == "__main__":
    main()
