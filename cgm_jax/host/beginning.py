"""Where a job begins: at its last checkpoint, at what it starts from, or from scratch."""

import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace

import jax

from cgm_jax.config.components import NAMES
from cgm_jax.config.fields import SettingError
from cgm_jax.config.grid import Group
from cgm_jax.host.checkpoint import TrainingProgress, check_last_checkpoint, load_checkpoint
from cgm_jax.host.jobs import Job
from cgm_jax.host.warm_start import Arrays, check_start, read_source, start_from
from cgm_jax.loop.compiler import Compiler, wait_for
from cgm_jax.loop.state import TrainingState
from cgm_jax.machine.device_errors import device_errors
from cgm_jax.results.statistics import have_finished
from cgm_jax.storage.checkpoints import finished_checkpoints
from cgm_jax.storage.config_file import start_beside
from cgm_jax.storage.layout import CONFIG
from cgm_jax.storage.metrics import Row, check_rows
from cgm_jax.storage.run_directory import RunDirectory


def check_last_checkpoints(jobs: Sequence[Job], directory: RunDirectory) -> None:
    """Check the jobs' last checkpoints before anything is recorded of resuming from them.

    Raises:
        SettingError: one holds the state of another program, or is of another version.
        ReadError: one cannot be read just now.
    """
    for index, job in enumerate(jobs):
        check_last_checkpoint(directory.path / "checkpoints", index, _shapes(job))


def check_starts(jobs: Sequence[Job], directory: RunDirectory) -> None:
    """Check that jobs without a checkpoint can start from what the sweep started from.

    Raises:
        SettingError: one cannot.
        ReadError: the checkpoints cannot be read just now.
    """
    for index, job in enumerate(jobs):
        if not finished_checkpoints(directory.path / "checkpoints", index):
            _start(job, directory)


def begin(
    job: Job, index: int, directory: RunDirectory, compiler: Compiler
) -> tuple[Job, TrainingProgress]:
    """A job whose programs are being compiled, and its last checkpoint or its beginning.

    Raises:
        SettingError: the checkpoint, or what the job starts from, does not fit or is gone.
        ReadError: one of them cannot be read just now.
        DeviceError: the programs cannot be compiled, or the states are too large.
    """
    hyper, training = job.group.hyper(), _last_checkpoint(job, index, directory)
    start = None if training else _start(job, directory)
    began = time.monotonic()
    with device_errors():
        if training is None or not is_finished(job.group, training):
            programs = compiler.programs(job.programs, hyper, starts=training is None)
            job = replace(job, programs=programs)
            if programs.trainer.setup.platform != "cpu":
                # A GPU is to have nothing else to do while XLA tries what is fastest on it.
                for program in (programs.start, programs.train, programs.evaluate):
                    wait_for(program)
        if training is None:
            state = job.programs.start(hyper)
            if start is not None:
                warm = start_from(start, job.programs, job.programs.spread(hyper), state)
                state = jax.device_put(warm, jax.tree.map(lambda leaf: leaf.sharding, state))
            training = TrainingProgress(state, runs=len(job.group.runs))
        else:
            training.state = job.programs.spread(training.state)
        jax.block_until_ready(training.state)
    training.wall_s += time.monotonic() - began
    return job, training


def _last_checkpoint(job: Job, index: int, directory: RunDirectory) -> TrainingProgress | None:
    """A job's last whole checkpoint, None if there is none; what others lack is said.

    Raises:
        SettingError: it belongs to other runs, or holds the state of another program.
        ReadError: it cannot be read just now.
    """
    training, notes = load_checkpoint(directory.path / "checkpoints", index, _shapes(job))
    where = f"resuming after epoch {training.epoch}" if training else "starting from the beginning"
    if training is not None:
        try:
            names = [run.name for run in job.group.runs]
            check_rows(training.rows, names, training.epoch)
            training.rows = _renamed(training.rows, job.group)
            if not 0 <= training.part < job.parts.total:
                raise ValueError(f"{training.part} parts of a cycle of {job.parts.total}")
        except (KeyError, ValueError) as error:
            raise SettingError(f"resume: the checkpoint belongs to other runs: {error}") from None
    for note in notes:
        print(f"{note}; {where}", file=sys.stderr)
    return training


def is_finished(group: Group, training: TrainingProgress) -> bool:
    """Whether all epochs are done, or all runs hold the success at which they may leave."""
    settings, rates = group.settings, [row["success_rate"] for row in training.rows]
    leave_at = None if training.cycle or training.part else settings.leave_at
    return have_finished(rates, len(group.runs), training.epoch, settings.epochs, leave_at)


def former_rows(group: Group, former: Mapping[str, Sequence[Row]]) -> list[Row]:
    """What an earlier process has written of a group's runs, epoch by epoch.

    Args:
        group: the runs.
        former: rows by run.
    """
    rows = [row for run in group.runs for row in former.get(run.name, ())]
    return sorted(_renamed(rows, group), key=lambda row: row["epoch"])


def keep_lost_metrics(index: int, directory: RunDirectory, *, lost: bool) -> bool:
    """Say that a group begins anew, if it had begun before, and keep metrics lost by that.

    Args:
        index: of the group.
        directory: what an earlier process has written, if there was one.
        lost: whether its metrics have rows of the group, or lines that are no rows of this sweep.

    Returns:
        Whether metrics were set aside, so that the file is not there.

    Raises:
        OSError: they cannot be.
    """
    if not lost and (index or directory.count_metrics() is None):
        return False
    note = f"no checkpoint of group {index}: it begins anew"
    if lost:
        note += f", and the metrics until now are kept as {directory.set_metrics_aside()}"
    print(note, file=sys.stderr)
    return lost


def _start(job: Job, directory: RunDirectory) -> Arrays | None:
    """What a job that begins starts from, which fits; None for from scratch.

    Raises:
        SettingError: it is missing or damaged, or does not fit.
    """
    path = start_beside(directory.path / CONFIG)
    if path is None:
        return None
    start = read_source(path)
    check_start(start, job.programs, job.group.hyper())
    return start


def _shapes(job: Job) -> TrainingState:
    """The training state of a job's runs, as mere shapes."""
    return jax.eval_shape(jax.vmap(job.programs.trainer.init), job.group.hyper())


def _renamed(rows: Sequence[Row], group: Group) -> list[Row]:
    """Rows with the names of today for own code: its files may have moved."""
    now = {
        run.name: {kind: run.values[kind] for kind in NAMES if kind in run.values}
        for run in group.runs
    }
    renamed = []
    for row in rows:
        names = {kind: name for kind, name in now[row["run"]].items() if kind in row}
        renamed.append(row | names)
    return renamed
