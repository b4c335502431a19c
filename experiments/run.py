"""Answer questions of the report: `python -m experiments.run QUESTION [QUESTION ...]`.

Trains a question's sweeps (plans.toml) into runs/experiments/SWEEP (`--runs`), where each resumes
from where it stopped. What is done is then recorded in results/sweeps/SWEEP. From those records
come tables and figures in results/QUESTION, and the tables and numbers of README.md.

What is on record as it is planned is left as it is, but with `--again`.

`--train` trains and leaves the records as they are, so that a checkout stays at its commit;
`--draw` trains nothing, records what is done and draws; `--report` only brings README.md up to
date, and takes no question. `--only` trains, or records, some of the questions' sweeps.
"""

import argparse
import sys
from collections.abc import Callable
from pathlib import Path

import matplotlib.pyplot as plt
from matplotlib.figure import Figure

from cgm_jax.results.figures import epochs_to_half, learning_curves, mask_success
from cgm_jax.storage.run_directory import RunDirectory
from experiments.learning.comparison import comparison
from experiments.learning.overview import overview
from experiments.learning.paired import comparisons
from experiments.learning.plans import (
    Plans,
    Question,
    Settings,
    options_of,
    planned_settings,
    read_plans,
)
from experiments.learning.records import (
    RecordedRun,
    Row,
    done_runs,
    is_whole,
    record,
    recorded_runs,
    recorded_settings,
    same_runs,
    trained_settings,
)
from experiments.learning.tables import Runs, learning_speed, metrics_of
from experiments.learning.train import train
from experiments.report import README, regenerated
from experiments.table import write_table

RUNS = Path("runs") / "experiments"
RESULTS = Path(__file__).parent / "results"
FIGURES: dict[str, Callable[[Runs], Figure]] = {
    "comparison": comparison,
    "overview": overview,
    "learning_curves": lambda runs: learning_curves(metrics_of(runs)),
    "epochs_to_half": lambda runs: epochs_to_half(metrics_of(runs)),
    "mask_success": lambda runs: mask_success(metrics_of(runs)),
}


def is_on_record(sweep: str, planned: Settings) -> bool:
    """Whether all runs of a sweep are on record, and are those that are planned now."""
    recorded = [settings for _, settings in recorded_settings(sweep)]
    return is_whole(sweep) and same_runs(recorded, planned_settings(planned))


def runs_on_record(sweep: str, planned: Settings) -> list[RecordedRun]:
    """A sweep's runs that are on record.

    Raises:
        ValueError: on record are other runs than are planned now.
    """
    recorded = [settings for _, settings in recorded_settings(sweep)]
    if recorded and not same_runs(recorded, planned_settings(planned)):
        raise ValueError(f"{sweep}: on record are other runs than are planned; --again trains it")
    return recorded_runs(sweep)


def check_unreplaced(sweep: str, planned: Settings, parser: argparse.ArgumentParser) -> None:
    """End where a record holds a run that is not planned as it is, and so would be lost."""
    runs = planned_settings(planned)
    lost = [run.name for run in recorded_runs(sweep) if run.settings not in runs]
    if lost:
        parser.error(
            f"{sweep}: {lost[0]} is on record with other settings than are planned; give the new "
            "plan a name of its own, or --again to replace the record"
        )


def tables_of(runs: Runs) -> dict[str, list[Row]]:
    """The tables of a question, by the name of their file."""
    return {"speed.csv": learning_speed(runs), "paired.csv": comparisons(runs)}


def write_results(name: str, question: Question, plans: Plans) -> Path:
    """Write figures and tables of a question.

    Raises:
        ValueError: nothing is on record, or other runs than planned.
    """
    runs = [run for sweep in question.sweeps for run in runs_on_record(sweep, plans.sweeps[sweep])]
    if not runs:
        raise ValueError(f"{name}: nothing is on record yet")
    target = RESULTS / name
    target.mkdir(parents=True, exist_ok=True)
    for file, rows in tables_of(runs).items():
        (target / file).unlink(missing_ok=True)
        if rows:
            write_table(target / file, rows)
    for figure in question.figures:
        _save(FIGURES[figure](runs), target / f"{figure}.png")
    return target


def is_finished(path: Path) -> bool:
    """Whether a directory holds a sweep of which all runs are done."""
    trained = RunDirectory(path)
    return trained.holds_sweep() and len(done_runs(trained)) == len(trained_settings(trained))


def _save(figure: Figure, path: Path) -> None:
    figure.savefig(path, dpi=130)
    plt.close(figure)


def _parser(plans: Plans) -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m experiments.run")
    parser.add_argument("questions", nargs="*", metavar="QUESTION", help=", ".join(plans.questions))
    mode = parser.add_mutually_exclusive_group()
    mode.add_argument("--train", action="store_true", help="only train, and record nothing")
    mode.add_argument("--draw", action="store_true", help="train nothing, draw from the records")
    mode.add_argument("--report", action="store_true", help="only bring README.md up to date")
    parser.add_argument(
        "--only", nargs="+", default=[], metavar="SWEEP", help="of the questions' sweeps only these"
    )
    parser.add_argument(
        "--again", action="store_true", help="train and replace also what is on record"
    )
    parser.add_argument(
        "--runs",
        type=Path,
        default=RUNS,
        metavar="DIR",
        help=f"where sweeps are trained, each in its own directory (default: {RUNS})",
    )
    parser.add_argument(
        "--at-once",
        type=int,
        default=1,
        metavar="N",
        help="train N sweeps at a time, each on its share of the cores",
    )
    return parser


def main() -> None:
    """Train and draw the questions named on the command line."""
    plans = read_plans()
    parser = _parser(plans)
    options = parser.parse_args()
    if unknown := [name for name in options.questions if name not in plans.questions]:
        parser.error(f"there is no question {unknown[0]!r}; there are {', '.join(plans.questions)}")
    if bool(options.questions) == options.report:
        parser.error("name questions to answer, or give --report alone")
    if options.again and options.report:
        parser.error("--again: goes with questions")
    if options.at_once < 1:
        parser.error(f"--at-once: {options.at_once} is not at least 1")
    sweeps = [sweep for name in options.questions for sweep in plans.questions[name].sweeps]
    if unknown := [name for name in options.only if name not in sweeps]:
        parser.error(f"--only: {unknown[0]!r} is no sweep of theirs; there are {', '.join(sweeps)}")
    sweeps = list(dict.fromkeys(options.only or sweeps))
    if not options.again:
        for name in sweeps:
            check_unreplaced(name, plans.sweeps[name], parser)
        there = [name for name in sweeps if is_on_record(name, plans.sweeps[name])]
        sweeps = [name for name in sweeps if name not in there]
        for name in [] if options.draw else there:
            print(f"{name}: on record; --again trains it again")
    if not (options.draw or options.report):
        asked_for = {name: options_of(plans.sweeps[name]) for name in sweeps}
        finished = [name for name in sweeps if is_finished(options.runs / name)]
        if options.again and finished:
            parser.error(f"--again: {options.runs / finished[0]} is done; name another --runs")
        train(asked_for, options.runs, options.at_once)
    if options.train:
        return
    try:
        for sweep in sweeps:
            trained = RunDirectory(options.runs / sweep)
            if trained.holds_sweep():
                record(trained, sweep, planned_settings(plans.sweeps[sweep]))
        for name in options.questions:
            print(write_results(name, plans.questions[name], plans))
        README.write_text(regenerated(README.read_text()))
    except ValueError as error:
        sys.exit(f"error: {error}")


if __name__ == "__main__":
    main()
