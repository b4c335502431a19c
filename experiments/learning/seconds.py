"""How long until 90 % are held? `python -m experiments.learning.seconds`, on an idle machine.

Trains the preset `cpu`, one seed after the other, each in a process of its own and with an empty
compilation cache, until it holds 90 %. Writes OUT/seconds.csv, one row a run: seconds from the
command to that evaluation (inf where it was never held); CPU seconds of the whole process, figures
included; and seconds that the machine would need for as many environment steps and updates at its
raw rates, with all cores busy: of MuJoCo's own batch on the task, and of a large matrix product.
"""

import math
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import tyro

from cgm_jax.config.fields import SettingError
from cgm_jax.host.command_line import parse, run_program
from cgm_jax.measuring.workload import choose_cpu
from cgm_jax.results.statistics import first_to_hold
from cgm_jax.storage.layout import METRICS
from cgm_jax.storage.provenance import provenance
from cgm_jax.storage.run_directory import RunDirectory
from experiments.pretrained import MEASURING, success
from experiments.table import read_table, write_table

Row = Mapping[str, Any]

TASKS = ("push", "pick_and_place")
OUT = Path(__file__).resolve().parents[1] / "results" / "seconds"


@dataclass(kw_only=True)
class SecondsOptions:
    """Time the preset `cpu` until it holds 90 %."""

    tasks: Annotated[tuple[str, ...], tyro.conf.Positional] = TASKS
    """Of which tasks."""

    seeds: int = 5
    """Runs per task."""

    out: Path = OUT
    """Directory for the table, in which other tasks and seeds keep their rows."""

    def check(self) -> None:
        """Check names and numbers.

        Raises:
            SettingError: a task that is not known, or no seed.
        """
        for task in self.tasks:
            if task not in TASKS:
                raise SettingError(f"tasks: {task!r} is none of {', '.join(TASKS)}")
        if self.seeds < 1:
            raise SettingError(f"seeds: {self.seeds} is below 1")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the program on command-line arguments; return its exit code."""
    options = parse(SecondsOptions, arguments, "python -m experiments.learning.seconds")
    options.check()
    choose_cpu()
    path = options.out / "seconds.csv"
    rows: list[Row] = list(read_table(path)) if path.exists() else []
    # Asked for once, before the table is another than the commit's.
    here = provenance("cpu", ())
    made = {key: here[key] for key in ("commit", "machine")}
    options.out.mkdir(parents=True, exist_ok=True)
    for task in options.tasks:
        rates = raw_rates(task)
        for seed in range(options.seeds):
            words = ["--preset", "cpu", "--env", task, "--seed", str(seed)]
            row = {"task": task, "seed": seed, **timed(task, words, 0.9, *rates), **made}
            print(row, flush=True)
            rows = replaced(rows, row)
            write_table(path, rows)
    return 0


def replaced(rows: Sequence[Row], row: Row) -> list[Row]:
    """Rows with one more, in place of that of the same run, in order of tasks and seeds."""

    def order(row: Row) -> tuple[int, int]:
        return TASKS.index(row["task"]), int(row["seed"])

    return sorted([row, *(other for other in rows if order(other) != order(row))], key=order)


def raw_rates(task: str) -> tuple[float, float]:
    """Environment steps, and updates of the preset, per second at the machine's raw rates."""
    from cgm_jax.host.startup import prepare_jax

    prepare_jax()
    from cgm_jax.measuring.figures import medians
    from cgm_jax.measuring.rollouts import rollout_seconds
    from cgm_jax.measuring.updates import (
        PRODUCT_OPERATIONS,
        inputs_of,
        large_product,
        update_operations,
    )
    from cgm_jax.measuring.workload import cpu_group

    simulations, repeats, group = 64, 5, cpu_group(task)
    _, raw = rollout_seconds(task, simulations, repeats)
    (product,) = medians([large_product()], repeats)
    agent, batch_size = group.runs[0].hyper.agent, group.settings.batch_size
    operations = update_operations(agent, batch_size, inputs_of(group))
    return 50 * simulations / raw, PRODUCT_OPERATIONS / product / operations


def timed(
    task: str, words: Sequence[str], level: float, steps_rate: float, update_rate: float
) -> dict[str, Any]:
    """What one run took until it held a success, which leaves then.

    Args:
        task: that it learns.
        words: options of `cgm_jax.train`.
        level: the success that is to be held.
        steps_rate: environment steps per second at the raw rate.
        update_rate: updates per second at the raw rate.

    Raises:
        RuntimeError: training has failed.
    """
    with tempfile.TemporaryDirectory() as temporary:
        directory = Path(temporary) / "run"
        environment = {**os.environ, "JAX_COMPILATION_CACHE_DIR": str(Path(temporary) / "cache")}
        command = [sys.executable, "-m", "cgm_jax.train", *words, "--leave-at", str(level)]
        began, used = time.time(), cpu_of_children()
        result = subprocess.run(
            [*command, "--out", str(directory)], env=environment, capture_output=True, check=False
        )
        if result.returncode:
            raise RuntimeError(f"train {' '.join(words)} has failed: {result.stderr.decode()}")
        used = cpu_of_children() - used
        written = RunDirectory(directory)
        rows = written.metrics()
        (run,) = (run for group in written.config.groups() for run in group.runs)
        raw = rows[-1]["env_steps"] / steps_rate + rows[-1]["updates"] / update_rate
        held = first_to_hold(rows, level) is not None
        held_s = (directory / METRICS).stat().st_mtime - began if held else math.inf
        return {
            "env_steps": rows[-1]["env_steps"],
            "updates": rows[-1]["updates"],
            "held_s": round(held_s, 1),
            "cpu_s": round(used, 1),
            "at_raw_rates_s": round(raw, 1),
            "ratio": round(held_s / raw, 2),
            "success_rate": success(task, {"": written.policy_path(run)}, MEASURING)[""],
            "episodes": MEASURING.episodes,
        }


def cpu_of_children() -> float:
    """CPU seconds of all processes that this one has waited for."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


if __name__ == "__main__":
    run_program(main)
