"""The host loop: chunks of training on the device, files and progress in between."""

import itertools
import time
from collections.abc import Sequence
from fractions import Fraction

import jax

from cgm_jax.config.grid import swept_settings
from cgm_jax.config.settings import Hyperparameters
from cgm_jax.host.beginning import begin, former_rows, is_finished, keep_lost_metrics
from cgm_jax.host.checkpoint import TrainingProgress
from cgm_jax.host.interruption import PATIENCE_SECONDS, Interruption
from cgm_jax.host.jobs import Job
from cgm_jax.host.pace import CHUNK_SECONDS, Pace
from cgm_jax.host.progress import SweepProgress
from cgm_jax.host.recorder import Recorder
from cgm_jax.host.watchdog import watchdog
from cgm_jax.loop.compiler import Compiler, is_compiling, wait_for
from cgm_jax.loop.cutting import WHOLE
from cgm_jax.loop.evaluation import Metrics
from cgm_jax.loop.training import Programs
from cgm_jax.machine.device_errors import device_errors
from cgm_jax.results.tracking import Tracking
from cgm_jax.storage.metrics import Row
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
    before = [former_rows(job.group, former) for job in jobs]
    known = sum(map(len, before))
    has_foreign_lines = (directory.count_metrics() or 0) > known
    written: list[Row] | None = None  # what the file holds, once that is known
    shard = directory.config.shard()
    swept = shard.swept if shard else swept_settings([job.group for job in jobs])
    for index, job in enumerate(jobs):
        progress.compiling()
        job, training = begin(job, index, directory, compiler)
        if not (training.epoch or training.cycle or training.part):
            lost = has_foreign_lines or bool(before[index])
            if keep_lost_metrics(index, directory, lost=lost):
                written = None
            has_foreign_lines = False
        # What later groups have done stays in the file, however this one ends.
        known_rows = [*rows, *training.rows, *itertools.chain(*before[index + 1 :])]
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
        while not is_finished(job.group, training):
            if _units_ahead(job, training)[1]:
                _train_chunk(job, training, hyper, pace, progress)
                training.wall_s = time.monotonic() - began
            else:
                metrics = _close_epoch(job.programs, training, hyper, pace, progress)
                training.wall_s = time.monotonic() - began
                progress.epoch(training.epoch, recorder.record_epoch(training, metrics))
            interruption.expendable = False
            something_happened()
            if is_finished(job.group, training):
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
