"""Tables and numbers of the report about physics, from what the programs of this room measured."""

from collections import defaultdict
from collections.abc import Callable
from pathlib import Path

import numpy as np

from experiments.markdown import Table, percent
from experiments.table import read_table

RESULTS = Path(__file__).parents[1] / "results"
TENTH = 0.1


def replay() -> Table:
    """Errors of replayed recordings, in millimetres."""
    rows = [
        [
            row["task"].replace("_", "-"),
            row["kind"],
            row["episodes"],
            f"{10 * float(row['median_largest_grip_error_cm']):.1f}",
            f"{10 * float(row['median_final_object_error_cm']):.1f}",
        ]
        for row in read_table(RESULTS / "fidelity" / "replay.csv")
    ]
    header = ["task", "actions", "episodes", "largest grip error, mm", "final object error, mm"]
    return Table(header, rows)


def entries_beyond_a_tenth() -> Table:
    """Entries of the observation that are off by over a tenth of their spread."""
    rows = [
        [
            row["task"].replace("_", "-"),
            row["entry"].replace("_", " "),
            percent(float(row["ratio"])),
        ]
        for row in read_table(RESULTS / "fidelity" / "observations.csv")
        if float(row["ratio"]) > TENTH
    ]
    return Table(["task", "entry", "mean error / spread"], rows, "None is.")


def sensitivity() -> Table:
    """How far Gymnasium-Robotics strays from its own recording, block shifted."""
    rows = [
        [
            f"{float(row['shift_mm']):g}",
            percent(float(row["yaw"])),
            percent(float(row["worst_other_entry"])),
        ]
        for row in read_table(RESULTS / "fidelity" / "sensitivity.csv")
    ]
    return Table(["block put down elsewhere by, mm", "yaw", "worst other entry"], rows)


def timestep() -> Table:
    """Errors, scripted success and speed per timestep, with the weld that has the least errors."""
    by_variant = defaultdict(dict)
    for row in read_table(RESULTS / "fidelity" / "timestep.csv"):
        by_variant[row["timestep"], row["weld_time"]][row["task"]] = row
    best = {}
    for (step, _), tasks in by_variant.items():
        error = sum(float(row["median_largest_grip_error_mm"]) for row in tasks.values())
        if step not in best or error < best[step][0]:
            best[step] = error, tasks
    rows = []
    for step, (_, tasks) in best.items():
        both = [tasks[task] for task in ("push", "pick_and_place")]
        grip = ", ".join(f"{float(row['median_largest_grip_error_mm']):.1f}" for row in both)
        block = ", ".join(f"{float(row['median_final_object_error_mm']):.1f}" for row in both)
        solved = ", ".join(percent(float(row["scripted_success"]), 1) for row in both)
        speed = np.mean([float(row["relative_speed"]) for row in both])
        name = f"{1000 * float(step):g} ms x {both[0]['substeps']}"
        rows.append([name, grip, block, solved, f"{speed:.1f}"])
    header = ["timestep x substeps", "grip error, mm", "object error, mm", "scripted success"]
    return Table([*header, "relative speed"], rows)


def transfer() -> Table:
    """Success of policies in Gymnasium-Robotics and here, from the same starts."""
    by_environment = defaultdict(list)
    for row in read_table(RESULTS / "transfer" / "transfer.csv"):
        by_environment[row["environment"]].append(row)
    rows = []
    for name, policies in by_environment.items():
        means = [
            f"{np.mean([float(row[column]) for row in policies]):.1f} %"
            for column in ("success_there", "success_here", "same_outcome")
        ]
        loss = [float(row["loss"]) for row in policies]
        episodes = f"{len(policies)} x {policies[0]['episodes']}"
        rows.append([name, episodes, *means, f"{min(loss):g} to {max(loss):g}"])
    header = ["environment", "policies x episodes", "success there", "success here"]
    return Table([*header, "same outcome", "lost by single policies, points"], rows)


def start() -> Table:
    """Seconds from the command to the end of the first training cycle, by engine."""
    phases = ("libraries", "tracing", "compiling", "first_cycle", "together")
    rows = [
        [row["engine"], *(f"{float(row[f'{phase}_s']):.1f}" for phase in phases)]
        for row in read_table(RESULTS / "engines" / "start.csv")
    ]
    header = ["engine", "libraries and scene", "tracing", "then compiling", "first cycle"]
    return Table([*header, "together"], rows)


def doing_nothing(task: str) -> str:
    """Success of a policy that does nothing."""
    table = read_table(RESULTS / "doing_nothing" / "doing_nothing.csv")
    (success,) = (float(row["success"]) for row in table if row["task"] == task)
    return percent(success, 1)


TABLES: dict[str, Callable[..., Table]] = {
    "replay": replay,
    "entries_beyond_a_tenth": entries_beyond_a_tenth,
    "sensitivity": sensitivity,
    "timestep": timestep,
    "transfer": transfer,
    "start": start,
}
VALUES: dict[str, Callable[..., str]] = {"doing_nothing": doing_nothing}
