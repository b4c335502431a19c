"""The host loop: chunks of training on the device, files and progress in between."""

import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import jax
import numpy as np

from cgm_jax.checkpoint import save_checkpoint
from cgm_jax.environments import make_environment
from cgm_jax.grid import Group, split
from cgm_jax.memory import bytes_per_run, runs_that_fit
from cgm_jax.pace import Pace
from cgm_jax.policy import policy_arrays
from cgm_jax.programs import Programs, make_programs, stack_runs
from cgm_jax.progress import SweepProgress
from cgm_jax.run_directory import RunDirectory
from cgm_jax.settings import Hyperparameters
from cgm_jax.training import Metrics, Trainer
from cgm_jax.training_state import TrainingState

CHECKPOINT_SECONDS = 300.0
"""Least time between two checkpoints of a group, other than its last."""


@dataclass(frozen=True)
class Job:
    """Runs that train side by side, and the programs that train them."""

    group: Group
    programs: Programs


def plan_jobs(groups: Sequence[Group]) -> tuple[list[Job], list[str]]:
    """Build what groups need, split those that do not fit into memory, and say what they take.

    Parts of one group share their programs, so that equal parts compile once.

    Returns:
        Jobs in order, and one line per group.

    Raises:
        SettingError: an environment cannot be made.
    """
    jobs, notes = [], []
    for group in groups:
        programs = make_programs(Trainer(make_environment(group.settings), group.settings))
        per_run = bytes_per_run(programs.trainer)
        parts = split(group, runs_that_fit(per_run))
        jobs += [Job(part, programs) for part in parts]
        largest = len(parts[0].runs)
        note = f"{group.settings.env}: {len(group.runs)} runs"
        if len(parts) > 1:
            note += f", {largest} at a time,"
        notes.append(f"{note} take {_size(largest * per_run)} ({_size(per_run)} each)")
    return jobs, notes


def _size(count: int) -> str:
    return f"{count / 2**20:,.1f} MiB" if count < 2**30 else f"{count / 2**30:,.1f} GiB"


def run_job(
    job: Job, index: int, directory: RunDirectory, progress: SweepProgress
) -> dict[str, float]:
    """Train all runs of a job side by side, and write what they give.

    Args:
        job: what to train.
        index: number of the job in its sweep.
        directory: where metrics, policies and checkpoints go.
        progress: is told of every chunk and epoch.

    Returns:
        Final success rate by run name.
    """
    started = saved = time.monotonic()
    group, programs, hyper = job.group, job.programs, stack_runs(job.group.runs)
    state, pace, success = programs.start(hyper), Pace(), {}
    for epoch in range(1, group.settings.epochs + 1):
        state = _train_epoch(programs, state, hyper, pace, progress)
        state, metrics = programs.evaluate(state, hyper)
        rows = _rows(group, epoch, time.monotonic() - started, metrics)
        directory.append_metrics(rows)
        success = {row["run"]: float(row["success_rate"]) for row in rows}
        progress.epoch(epoch, int(rows[0]["env_steps"]), success)
        due = time.monotonic() - saved > CHECKPOINT_SECONDS
        if due or epoch == group.settings.epochs:
            _write_policies(group, directory, state)
            save_checkpoint(directory.path / "checkpoints", index, epoch, state)
            saved = time.monotonic()
    return success


def _train_epoch(
    programs: Programs,
    state: TrainingState,
    hyper: Hyperparameters,
    pace: Pace,
    progress: SweepProgress,
) -> TrainingState:
    trainer = programs.trainer
    remaining = trainer.settings.cycles_per_epoch
    steps_per_cycle = trainer.settings.environments * trainer.env.episode_length
    runs = len(jax.tree.leaves(hyper)[0])
    while remaining:
        cycles = pace.next_chunk(remaining)
        began = time.monotonic()
        state = jax.block_until_ready(programs.train(state, hyper, cycles))
        seconds = time.monotonic() - began
        pace.record(cycles, seconds)
        remaining -= cycles
        progress.advance(cycles, cycles * steps_per_cycle * runs, seconds)
    return state


def _rows(group: Group, epoch: int, wall_s: float, metrics: Metrics) -> list[dict[str, Any]]:
    arrays = {name: np.asarray(value) for name, value in metrics.items()}
    return [
        {
            "run": run.name,
            "env": group.settings.env,
            "seed": run.hyper.seed,
            "c_g": run.hyper.c_g,
            "kappa": run.hyper.kappa,
            "her": run.hyper.her,
            "cgm": run.hyper.cgm,
            "epoch": epoch,
            "wall_s": round(wall_s, 3),
            **{name: values[i] for name, values in arrays.items()},
        }
        for i, run in enumerate(group.runs)
    ]


def _write_policies(group: Group, directory: RunDirectory, state: TrainingState) -> None:
    for i, run in enumerate(group.runs):
        one = jax.tree.map(lambda leaf, i=i: leaf[i], (state.agent.actor, state.normaliser))
        directory.write_policy(run, policy_arrays(*one))
