"""The host loop: chunks of training on the device, files and progress in between."""

import itertools
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from fractions import Fraction

import jax

from cgm_jax.config.components import NAMES
from cgm_jax.config.fields import SettingError
from cgm_jax.config.grid import Group, swept_settings
from cgm_jax.config.settings import Hyperparameters
from cgm_jax.host.checkpoint import TrainingProgress, check_last_checkpoint, load_checkpoint
from cgm_jax.host.interruption import PATIENCE_SECONDS, Interruption
from cgm_jax.host.jobs import Job
from cgm_jax.host.pace import CHUNK_SECONDS, Pace
from cgm_jax.host.progress import SweepProgress
from cgm_jax.host.recorder import Recorder
from cgm_jax.host.warm_start import Arrays, check_start, read_source, start_from
from cgm_jax.host.watchdog import watchdog
from cgm_jax.loop.compiler import Compiler, is_compiling, wait_for
from cgm_jax.loop.cutting import WHOLE
from cgm_jax.loop.evaluation import Metrics
from cgm_jax.loop.state import TrainingState
from cgm_jax.loop.training import Programs
from cgm_jax.machine.device_errors import device_errors
from cgm_jax.results.statistics import have_finished
from cgm_jax.results.tracking import Tracking
from cgm_jax.storage.checkpoints import finished_checkpoints
from cgm_jax.storage.config_file import start_beside
from cgm_jax.storage.layout import CONFIG
from cgm_jax.storage.metrics import Row, check_rows
from cgm_jax.storage.run_directory import RunDirectory


def run_jobs(
    jobs: Sequence[Job],
    directory: RunDirectory,
    progress: SweepProgress,
    interruption: Interruption,
    checkpoint_seconds: float,
    tracking: Tracking,
    compiler: Compiler,
) -> list[Row] | None:
    """Train all jobs one after another, each from its last checkpoint.

    Args:
        jobs: what to train.
        directory: where metrics, policies and checkpoints go.
        progress: is told of every chunk and epoch.
        interruption: says when to stop.
        checkpoint_seconds: least time between two checkpoints of a job, other than its last.
        tracking: is sent what is recorded.
        compiler: compiles the programs.

    Returns:
        The last row of every run; None if a signal came, and what was done is in a checkpoint.

    Raises:
        DeviceError: the physics, the memory or something else below has failed.
        OSError: metrics, or a job's last checkpoint, cannot be written; or, as a ReadError says,
            read.
        SettingError: a checkpoint holds the state of another program, or what a job was to start
            from is gone.
    """
    rows, last, former = [], [], directory.former_metrics()
    former_rows = [_former_rows(job.group, former) for job in jobs]
    known = sum(map(len, former_rows))
    has_foreign_lines = (directory.count_metrics() or 0) > known
    written: list[Row] | None = None  # what the file holds, once that is known
    shard = directory.config.shard()
    swept = shard.swept if shard else swept_settings([job.group for job in jobs])
    for index, job in enumerate(jobs):
        progress.compiling()
        job, training = _begin(job, index, directory, compiler)
        if not (training.epoch or training.cycle or training.part):
            lost = has_foreign_lines or bool(former_rows[index])
            if _keep_lost_metrics(index, directory, lost=lost):
                written = None
            has_foreign_lines = False
        # What later groups have done stays in the file, however this one ends.
        known_rows = [*rows, *training.rows, *itertools.chain(*former_rows[index + 1 :])]
        if written != known_rows:  # of many groups that are done each would write all of them
            directory.replace_metrics(known_rows)
        done_before = len(training.rows)
        settings = job.group.settings
        done = training.epoch * settings.cycles_per_epoch + training.cycle
        progress.skip(done + Fraction(training.part, job.parts.total))
        recorder = Recorder(
            directory, job.group, index, training.rows, checkpoint_seconds, swept, tracking
        )
        if not _train(job, training, recorder, progress, interruption):
            return None
        progress.skip((settings.epochs - training.epoch) * settings.cycles_per_epoch)
        tracking.end()
        written = known_rows + training.rows[done_before:]
        rows += training.rows
        last += training.rows[-len(job.group.runs) :]
    return last


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


def _begin(
    job: Job, index: int, directory: RunDirectory, compiler: Compiler
) -> tuple[Job, TrainingProgress]:
    """A job whose programs are being compiled, and its last checkpoint or its beginning."""
    hyper = job.group.hyper()
    training, notes = load_checkpoint(directory.path / "checkpoints", index, _shapes(job))
    if training is not None:
        try:
            names = [run.name for run in job.group.runs]
            check_rows(training.rows, names, training.epoch)
            training.rows = _renamed(training.rows, job.group)
            if not 0 <= training.part < job.parts.total:
                raise ValueError(f"{training.part} parts of a cycle of {job.parts.total}")
        except (KeyError, ValueError) as error:
            raise SettingError(f"resume: the checkpoint belongs to other runs: {error}") from None
    where = f"resuming after epoch {training.epoch}" if training else "starting from the beginning"
    for note in notes:
        print(f"{note}; {where}", file=sys.stderr)
    start = None if training else _start(job, directory)
    began = time.monotonic()
    with device_errors():
        if training is None or not _is_finished(job.group, training):
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


def _former_rows(group: Group, former: Mapping[str, Sequence[Row]]) -> list[Row]:
    """What an earlier process has written of a group's runs, epoch by epoch.

    Args:
        group: the runs.
        former: rows by run.
    """
    rows = [row for run in group.runs for row in former.get(run.name, ())]
    return sorted(_renamed(rows, group), key=lambda row: row["epoch"])


def _keep_lost_metrics(index: int, directory: RunDirectory, *, lost: bool) -> bool:
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


def _train(
    job: Job,
    training: TrainingProgress,
    recorder: Recorder,
    progress: SweepProgress,
    interruption: Interruption,
) -> bool:
    """Train a job, chunk by chunk, to its end (true) or until a signal comes (false)."""
    hyper = job.group.hyper()
    began, pace = time.monotonic() - training.wall_s, Pace()
    with watchdog() as something_happened:
        while not _is_finished(job.group, training):
            if _units_ahead(job, training)[1]:
                _train_chunk(job, training, hyper, pace, progress)
                training.wall_s = time.monotonic() - began
            else:
                metrics = _close_epoch(job.programs, training, hyper, pace, progress)
                training.wall_s = time.monotonic() - began
                progress.epoch(training.epoch, recorder.record_epoch(training, metrics))
            interruption.expendable = False
            something_happened()
            if _is_finished(job.group, training):
                recorder.save(training)
                continue
            # What may take longer than a signal waits begins with a checkpoint, to be cut off.
            must = interruption.requested or _may_outlast_patience(job, training, recorder, pace)
            saved = recorder.try_to_save(training) if must else recorder.save_if_due(training)
            if saved:
                pace.record_checkpoint()
            if interruption.requested and (must or saved):
                return False
            interruption.expendable = must and saved
    interruption.expendable = True
    return not interruption.requested


def _may_outlast_patience(
    job: Job, training: TrainingProgress, recorder: Recorder, pace: Pace
) -> bool:
    """Whether the next chunk or evaluation, and a checkpoint after it, may outlast a signal.

    It is expected to take as long as the last of its kind in this process. Before there was one,
    the answer is whether the work that is not saved took longer than the patience; or than a chunk,
    if an evaluation comes next that has yet to compile. Always false until four times as long has
    passed since the last checkpoint as it took, so that saving takes at most a fifth of the time.
    """
    if recorder.unsaved_seconds() < 4 * recorder.save_seconds:
        return False
    patience = PATIENCE_SECONDS - recorder.save_seconds
    kind, remaining = _units_ahead(job, training)
    expected = pace.unit(kind) if remaining else pace.evaluation
    if expected is not None:
        return expected > patience
    compiling = not remaining and is_compiling(job.programs.evaluate)
    return pace.at_risk > (CHUNK_SECONDS if compiling else patience)


def _is_finished(group: Group, training: TrainingProgress) -> bool:
    """Whether all epochs are done, or all runs hold the success at which they may leave."""
    settings, rates = group.settings, [row["success_rate"] for row in training.rows]
    leave_at = None if training.cycle or training.part else settings.leave_at
    return have_finished(rates, len(group.runs), training.epoch, settings.epochs, leave_at)


def _train_chunk(
    job: Job,
    training: TrainingProgress,
    hyper: Hyperparameters,
    pace: Pace,
    progress: SweepProgress,
) -> None:
    settings, env = job.group.settings, job.programs.trainer.setup.env
    kind, remaining = _units_ahead(job, training)
    units = pace.next_chunk(kind, remaining)
    with device_errors():
        wait_for(job.programs.train)
        began = time.monotonic()
        training.state = jax.block_until_ready(job.programs.train(training.state, hyper, units))
    pace.record(kind, units, time.monotonic() - began)
    cycles, training.part = divmod(training.part + units, job.parts.total)
    training.cycle += cycles
    progress.advance(Fraction(units, job.parts.total))
    if (seconds := _cycle_seconds(job, pace)) is not None:
        steps_per_cycle = settings.environments * env.episode_length
        progress.show_speed(steps_per_cycle * len(job.group.runs), seconds)


def _units_ahead(job: Job, training: TrainingProgress) -> tuple[str, int]:
    """What is trained next until something else comes: its kind for `Pace`, and how many of it.

    None is left where an evaluation comes next.
    """
    cycles = max(0, job.group.settings.cycles_per_epoch - training.cycle)
    if job.parts == WHOLE or not cycles:
        return "cycle", cycles
    if training.part < job.parts.rollout:
        return "rollout", job.parts.rollout - training.part
    return "updates", job.parts.total - training.part


def _cycle_seconds(job: Job, pace: Pace) -> float | None:
    """How long a cycle takes at this pace, if that is known yet."""
    if job.parts == WHOLE:
        return pace.unit("cycle")
    step, block = pace.unit("rollout"), pace.unit("updates")
    if step is None or block is None:
        return None
    return job.parts.rollout * step + job.parts.updates * block


def _close_epoch(
    programs: Programs,
    training: TrainingProgress,
    hyper: Hyperparameters,
    pace: Pace,
    progress: SweepProgress,
) -> Metrics:
    with device_errors():
        if is_compiling(programs.evaluate):
            progress.compiling()
            wait_for(programs.evaluate)
        began = time.monotonic()
        training.state, metrics = jax.block_until_ready(programs.evaluate(training.state, hyper))
    pace.record_evaluation(time.monotonic() - began)
    training.epoch, training.cycle = training.epoch + 1, 0
    return metrics
