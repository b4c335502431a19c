"""This program beside Stable-Baselines3: `make compare-sb3`.

Trains every arm on every task, each run on one core (where the system has `taskset`), until it has
used its CPU seconds, from the start of its process with an empty compilation cache; a run of this
program ends with the preset, if that is sooner. Writes the curve of each into OUT/curves, which run
was made where into OUT/runs.csv, and the figure. Runs that are there are not trained again; other
CPU seconds are for another OUT. Other work on the machine makes CPU seconds do less; and each run
imports the checkout as it then is, which is to stay as it was.
"""

import os
import queue
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass
from pathlib import Path

from cgm_jax.config.fields import SettingError
from cgm_jax.host.command_line import parse, run_program
from cgm_jax.host.exit_codes import ExitCode
from cgm_jax.machine.allotment import available_cores
from cgm_jax.storage.lock import locked
from cgm_jax.storage.provenance import provenance
from experiments.other_programs.arms import ARMS, NAMES, OURS, TASKS
from experiments.other_programs.figure import draw
from experiments.other_programs.runs import RUNS, Run, runs_made
from experiments.table import read_table, write_table

ROOT = Path(__file__).resolve().parents[2]


@dataclass(kw_only=True)
class CompareOptions:
    """Train this program and Stable-Baselines3 on the same tasks, each run on a core."""

    cpu_seconds: float = 7200.0
    """That each run may use."""

    arms: tuple[str, ...] = NAMES
    """Who learns."""

    tasks: tuple[str, ...] = tuple(TASKS)
    """What is to be learned."""

    seeds: tuple[int, ...] = (0,)
    """One run for each."""

    python: Path = ROOT / ".venv-compare" / "bin" / "python"
    """The Python that has stable-baselines3 and gymnasium-robotics."""

    out: Path = ROOT / "experiments" / "results" / "other_programs"
    """Directory for curves, table and figure."""

    def check(self) -> None:
        """Check names and numbers.

        Raises:
            SettingError: one of them is not known, or out of its range; or the directory holds runs
                of other CPU seconds.
        """
        for name in ("arms", "tasks", "seeds"):
            if not getattr(self, name):
                raise SettingError(f"{name}: needs at least one value")
        for name, known in (("arms", NAMES), ("tasks", tuple(TASKS))):
            for value in getattr(self, name):
                if value not in known:
                    raise SettingError(f"{name}: {value!r} is none of {', '.join(known)}")
        if not self.cpu_seconds > 0:
            raise SettingError(f"cpu_seconds: {self.cpu_seconds:g} is not above 0")
        if min(self.seeds) < 0:
            raise SettingError(f"seeds: {min(self.seeds)} is below 0")
        if {*self.arms} & ARMS.keys() and not self.python.is_file():
            raise SettingError(f"python: there is no {self.python}; make compare-sb3 builds it")
        made = read_table(self.out / RUNS) if (self.out / RUNS).exists() else []
        if others := {float(row["cpu_seconds"]) for row in made} - {self.cpu_seconds}:
            raise SettingError(
                f"cpu_seconds: {self.out} holds runs of {others.pop():g}; name another directory"
            )


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the program on command-line arguments; return its exit code."""
    options = parse(CompareOptions, arguments, "python -m experiments.other_programs.compare")
    options.check()
    options.out.mkdir(parents=True, exist_ok=True)
    with locked(options.out):
        failures = list(train_missing(options))
        for failure in failures:
            print(f"error: {failure}", file=sys.stderr)
        if failures:
            return ExitCode.FAILED
        draw(options.out)
    return ExitCode.DONE


def train_missing(options: CompareOptions) -> Iterator[BaseException]:
    """Train the runs that are not there; how those failed that did."""
    here = provenance("cpu", ())
    made = {key: here[key] for key in ("commit", "machine")}
    wanted = {
        Run(arm, task, seed): None  # in this order, each once
        for seed in options.seeds
        for task in options.tasks
        for arm in options.arms
    }
    there = runs_made(options.out)
    for run, failure in train_all([run for run in wanted if run not in there], options):
        if failure is not None:
            yield failure
            continue
        run.partial(options.out).replace(run.path(options.out))
        note(run, options, made)  # last: what is noted is there
        print(f"trained: {run.arm}, {run.task}, seed {run.seed}", flush=True)


def train_all(
    runs: Sequence[Run], options: CompareOptions
) -> Iterator[tuple[Run, BaseException | None]]:
    """Train runs side by side, one on each core; each when it is over, and how it failed."""
    cores = sorted(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else [0]
    free: queue.SimpleQueue[int] = queue.SimpleQueue()
    for core in cores[: available_cores()]:
        free.put(core)
    with ThreadPoolExecutor(free.qsize()) as pool:
        pending = {pool.submit(train, run, options, free): run for run in runs}
        try:
            for future in as_completed(pending):
                yield pending[future], future.exception()
        finally:  # stopped: what has not begun is not to begin
            pool.shutdown(wait=False, cancel_futures=True)


def train(run: Run, options: CompareOptions, free: "queue.SimpleQueue[int]") -> None:
    """Train a run on a core that is free.

    Raises:
        RuntimeError: it has failed; with what it said.
    """
    partial = run.partial(options.out).resolve()
    rest = (run.arm, run.task, str(run.seed), str(options.cpu_seconds), str(partial))
    if run.arm in OURS:
        program = (sys.executable, "-m", "experiments.other_programs.our_run")
    else:
        program = (str(options.python), "-m", "experiments.other_programs.sb3_run")
    core = free.get()
    try:
        with tempfile.TemporaryDirectory() as cache:
            settings = {"OMP_NUM_THREADS": "1", "JAX_PLATFORMS": "cpu"}
            result = subprocess.run(
                on_core(core, (*program, *rest)),
                cwd=ROOT,
                env={**os.environ, **settings, "JAX_COMPILATION_CACHE_DIR": cache},
                capture_output=True,
                text=True,
                check=False,
            )
    finally:
        free.put(core)
    if result.returncode:
        raise RuntimeError(f"{partial.stem} has failed:\n{result.stderr}")


def on_core(core: int, command: Sequence[str]) -> Sequence[str]:
    """The command, kept to one core where the system can."""
    return ("taskset", "--cpu-list", str(core), *command) if shutil.which("taskset") else command


def note(run: Run, options: CompareOptions, made: Mapping[str, str]) -> None:
    """Keep with which CPU seconds, and where, a run was made: a row each."""
    path = options.out / RUNS
    row = {**run._asdict(), "cpu_seconds": options.cpu_seconds, **made}
    others = read_table(path) if path.exists() else []
    named = {name: str(value) for name, value in run._asdict().items()}
    kept = [other for other in others if {name: other[name] for name in named} != named]
    write_table(path, [*kept, row])


if __name__ == "__main__":
    run_program(main)
