"""This program beside Stable-Baselines3: `make compare-sb3`.

Trains every arm on every task, each run on one core, until it has used its CPU seconds (this
program's run ends with the preset). Writes the curve of each into OUT/curves, which run was made
where into OUT/runs.csv, and the figure. Runs that are there are not trained again.
"""

import os
import queue
import subprocess
import sys
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from cgm_jax.config.fields import SettingError
from cgm_jax.host.command_line import parse, run_program
from cgm_jax.storage.provenance import provenance
from experiments.other_programs.arms import ARMS, OURS, TASKS
from experiments.other_programs.figure import draw
from experiments.table import read_table, write_table

ROOT = Path(__file__).resolve().parents[2]


@dataclass(kw_only=True)
class CompareOptions:
    """Train this program and Stable-Baselines3 on the same tasks, each run on a core."""

    cpu_seconds: float = 7200.0
    """That each run may use."""

    arms: tuple[str, ...] = (OURS, *ARMS)
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
            SettingError: one of them is not known, or out of its range.
        """
        for name, known in (("arms", (OURS, *ARMS)), ("tasks", tuple(TASKS))):
            for value in getattr(self, name):
                if value not in known:
                    raise SettingError(f"{name}: {value!r} is none of {', '.join(known)}")
        if not self.cpu_seconds > 0:
            raise SettingError(f"cpu_seconds: {self.cpu_seconds:g} is not above 0")
        if min(self.seeds) < 0:
            raise SettingError(f"seeds: {min(self.seeds)} is below 0")
        if {*self.arms} != {OURS} and not self.python.is_file():
            raise SettingError(f"python: there is no {self.python}; make compare-sb3 builds it")


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


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the program on command-line arguments; return its exit code."""
    options = parse(CompareOptions, arguments, "python -m experiments.other_programs.compare")
    options.check()
    wanted = [
        Run(arm, task, seed)
        for seed in options.seeds
        for task in options.tasks
        for arm in options.arms
    ]
    missing = [run for run in wanted if not run.path(options.out).exists()]
    cores = sorted(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else [0]
    free: queue.SimpleQueue[int] = queue.SimpleQueue()
    for core in cores:
        free.put(core)
    with ThreadPoolExecutor(len(cores)) as pool:
        for done in as_completed([pool.submit(train, run, options, free) for run in missing]):
            run = done.result()
            note(run, options)
            run.partial(options.out).replace(run.path(options.out))
            print(f"trained: {run.arm}, {run.task}, seed {run.seed}", flush=True)
    draw(options.out)
    return 0


def train(run: Run, options: CompareOptions, free: "queue.SimpleQueue[int]") -> Run:
    """Train a run on a core that is free.

    Raises:
        RuntimeError: it has failed; with what it said.
    """
    partial = run.partial(options.out).resolve()
    rest = (run.task, str(run.seed), str(options.cpu_seconds), str(partial))
    if run.arm == OURS:
        command = (sys.executable, "-m", "experiments.other_programs.our_run", *rest)
    else:
        module = "experiments.other_programs.sb3_run"
        command = (str(options.python), "-m", module, run.arm, *rest)
    core = free.get()
    try:
        result = subprocess.run(
            on_core(core, command),
            cwd=ROOT,
            env={**os.environ, "OMP_NUM_THREADS": "1", "JAX_PLATFORMS": "cpu"},
            capture_output=True,
            text=True,
            check=False,
        )
    finally:
        free.put(core)
    if result.returncode:
        raise RuntimeError(f"{partial.stem} has failed:\n{result.stderr}")
    return run


def on_core(core: int, command: Sequence[str]) -> Sequence[str]:
    """The command, kept to one core where the system can."""
    return ("taskset", "--cpu-list", str(core), *command) if sys.platform == "linux" else command


def note(run: Run, options: CompareOptions) -> None:
    """Keep where a run was made, one row each."""
    path = options.out / "runs.csv"
    here = provenance("cpu", ())
    row = {
        **run._asdict(),
        "cpu_seconds": options.cpu_seconds,
        "commit": here["commit"],
        "machine": here["machine"],
    }
    others = read_table(path) if path.exists() else []
    named = {name: str(value) for name, value in run._asdict().items()}
    kept = [other for other in others if {name: other[name] for name in named} != named]
    write_table(path, [*kept, row])


if __name__ == "__main__":
    run_program(main)
