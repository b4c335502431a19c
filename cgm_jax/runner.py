"""The host loop: chunks of training on the device, files and progress in between."""

import time
from collections.abc import Sequence
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


def fit_into_memory(groups: Sequence[Group]) -> tuple[list[Group], list[str]]:
    """Split groups that do not fit; say per group how much memory it will take."""
    fitting, notes = [], []
    for group in groups:
        per_run = bytes_per_run(Trainer(make_environment(group.settings), group.settings))
        parts = split(group, runs_that_fit(per_run))
        fitting += parts
        note = f"{group.settings.env}: {len(group.runs)} runs of {per_run / 2**20:,.0f} MiB"
        if len(parts) > 1:
            note += f", {len(parts[0].runs)} at a time"
        notes.append(note)
    return fitting, notes


def run_group(
    group: Group, index: int, directory: RunDirectory, progress: SweepProgress
) -> dict[str, float]:
    """Train all runs of a group side by side, and write what they give.

    Args:
        group: runs of one program.
        index: number of the group in its sweep.
        directory: where metrics, policies and checkpoints go.
        progress: is told of every chunk and epoch.

    Returns:
        Final success rate by run name.
    """
    started = saved = time.monotonic()
    trainer = Trainer(make_environment(group.settings), group.settings)
    programs, hyper = make_programs(trainer), stack_runs(group.runs)
    state, pace, success = programs.start(hyper), Pace(), {}
    for epoch in range(1, group.settings.epochs + 1):
        state = _train_epoch(trainer, programs, state, hyper, pace, progress)
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
    trainer: Trainer,
    programs: Programs,
    state: TrainingState,
    hyper: Hyperparameters,
    pace: Pace,
    progress: SweepProgress,
) -> TrainingState:
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
