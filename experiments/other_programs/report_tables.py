"""What the report says of other programs, from the curves on record."""

from collections.abc import Callable
from pathlib import Path

from cgm_jax.results.statistics import HOLDING_EVALUATIONS, first_to_hold
from experiments.markdown import NOT_YET, Table, counted, in_words
from experiments.other_programs.arms import NAMES, TASKS, label
from experiments.other_programs.compare import CompareOptions
from experiments.other_programs.runs import Run, runs_made
from experiments.table import read_table

LEVEL = 0.9


def other_programs(out: Path = CompareOptions.out) -> Table:
    """When each run holds 90 %, and where it ends."""
    runs = runs_made(out)
    in_order = sorted(
        runs, key=lambda run: ([*TASKS].index(run.task), NAMES.index(run.arm), run.seed)
    )
    header = ["task", "program", "seed", "90 % held after, CPU seconds", "thousand steps"]
    header += ["end, %", "thousand steps then", "CPU seconds then"]
    return Table(header, [_row(run, out) for run in in_order])


def held_by_program(arm: str, task: str, out: Path = CompareOptions.out) -> str:
    """How many runs of an arm hold 90 % on a task, such as "three of three seeds"."""
    runs = [r for r in runs_made(out) if (r.arm, r.task) == (arm, task)]
    if not runs:
        return NOT_YET
    held = sum(first_to_hold(_curve(run, out), LEVEL) is not None for run in runs)
    return f"{in_words(held)} of {counted(len(runs), 'seed')}"


def _curve(run: Run, out: Path) -> list[dict[str, float]]:
    return [{name: float(row[name]) for name in row} for row in read_table(run.path(out))]


def _row(run: Run, out: Path) -> list[str]:
    rows = _curve(run, out)
    held, last = first_to_hold(rows, LEVEL), rows[-1]
    final = [row["success_rate"] for row in rows[-HOLDING_EVALUATIONS:]]
    return [
        run.task.replace("_", "-"),
        label(run.arm),
        str(run.seed),
        *([f"{held['cpu_s']:.0f}", f"{held['env_steps'] / 1000:g}"] if held else ["never", ""]),
        f"{round(100 * sum(final) / len(final), 1):g}",
        f"{round(last['env_steps'] / 1000):,}",
        f"{last['cpu_s']:,.0f}",
    ]


TABLES: dict[str, Callable[..., Table]] = {"other_programs": other_programs}
VALUES: dict[str, Callable[..., str]] = {"held_by_program": held_by_program}
