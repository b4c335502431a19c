"""The host loop: chunks of training on the device, files and progress in between."""

import itertools
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

import jax

from cgm_jax.config.components import NAMES
from cgm_jax.config.fields import SettingError
from cgm_jax.config.grid import Group, Run, split, structure, swept_settings
from cgm_jax.config.settings import Hyperparameters, Settings
from cgm_jax.envs import GoalEnvironment
from cgm_jax.host.checkpoint import TrainingProgress, check_last_checkpoint, load_checkpoint
from cgm_jax.host.device_errors import device_errors
from cgm_jax.host.interruption import PATIENCE_SECONDS, Interruption
from cgm_jax.host.memory import NOT_COUNTED, estimate_memory, format_bytes, runs_that_fit
from cgm_jax.host.pace import CHUNK_SECONDS, Pace
from cgm_jax.host.progress import SweepProgress
from cgm_jax.host.recorder import Recorder
from cgm_jax.host.warm_start import read_source, start_from
from cgm_jax.host.watchdog import watchdog
from cgm_jax.loop.compiler import Compiler, is_compiling, wait_for
from cgm_jax.loop.devices import Device, share
from cgm_jax.loop.environment import compiles_physics, make_environment, remarks_on
from cgm_jax.loop.evaluation import Metrics
from cgm_jax.loop.own_components import check_components
from cgm_jax.loop.state import TrainingState
from cgm_jax.loop.training import Programs, Trainer, make_programs, make_trainer
from cgm_jax.results.statistics import have_finished
from cgm_jax.results.tracking import Tracking
from cgm_jax.storage.config_file import start_beside
from cgm_jax.storage.layout import CONFIG
from cgm_jax.storage.metrics import Row, check_rows
from cgm_jax.storage.run_directory import RunDirectory


@dataclass(frozen=True)
class Job:
    """Runs that train side by side, and the programs that train them."""

    group: Group
    programs: Programs


def plan_jobs(
    groups: Sequence[Group], devices: Sequence[Device], *, planned: bool = False
) -> tuple[list[Job], list[str]]:
    """Build what groups need, split those that do not fit into memory, and say what they take.

    Parts of one group share their programs, so that equal parts compile once.

    Args:
        groups: the parts of one program next to each other.
        devices: that share the runs of each.
        planned: whether they are the parts of an earlier plan. Those stay, whatever the memory
            is today: a checkpoint holds the runs of a part.

    Returns:
        Jobs in order, and one line per program.

    Raises:
        SettingError: an environment cannot be made, a run does not fit into memory, or a count
            would overflow.
    """
    jobs, notes = [], []
    environments: dict[Settings, GoalEnvironment] = {}
    for _, same in itertools.groupby(groups, key=_program):
        parts, made = list(same), dict[int, Programs]()
        settings, runs = parts[0].settings, [run for part in parts for run in part.runs]
        if settings not in environments:
            environments[settings] = make_environment(settings)
        trainer = make_trainer(environments[settings], settings)
        _check_counters(trainer)
        check_components(trainer, runs[0])
        remarks = [*remarks_on(trainer.setup.env), *_remarks_on_discount(trainer, runs)]
        notes += [remark for remark in remarks if remark not in notes]
        estimate = estimate_memory(trainer, runs[0].hyper)
        if not planned:
            (whole,) = parts
            fitting = runs_that_fit(estimate, len(runs), len(devices))
            parts = split(whole, min(fitting, settings.side_by_side))
        for part in parts:
            count = share(len(part.runs), len(devices)).devices
            if count not in made:
                made[count] = make_programs(trainer, devices[:count])
            jobs.append(Job(part, made[count]))
        largest = max(len(part.runs) for part in parts)
        note = f"{settings.env}: {len(runs)} runs"
        if len(parts) > 1:
            note += f", {largest} at a time,"
        note += f" take {format_bytes(estimate.total(largest, len(devices)))} of memory"
        if (sharing := share(largest, len(devices)).devices) > 1:
            note += f" on {'each of ' if not estimate.on_cpu else ''}{sharing} devices"
        notes.append(note + (NOT_COUNTED if compiles_physics(trainer.setup.env) else ""))
    return jobs, notes


def _program(group: Group) -> object:
    """What groups of one program have in common."""
    return structure(group.settings, group.runs[0].hyper)


def _remarks_on_discount(trainer: Trainer, runs: Sequence[Run]) -> list[str]:
    """What to say of runs that bootstrap from states in which they never act.

    The critic knows a state's value from the actions taken in it. With one step to an episode none
    is ever taken in the state that follows, whose value then drifts and takes the others along.
    """
    settings, episode_length = trainer.setup.settings, trainer.setup.env.episode_length
    discount = max((run.values.get("discount", 0.0) for run in runs), default=0.0)
    if episode_length > 1 or not discount:
        return []
    return [
        f"{settings.env}: its episodes have one step, so that nothing follows whose value discount "
        f"({discount:g}) could count: --discount 0 is what they need"
    ]


def _check_counters(trainer: Trainer) -> None:
    """Refuse to train for longer than the int32 counters of a run can count.

    Raises:
        SettingError: it would take 2^31 environment steps or updates.
    """
    settings, env = trainer.setup.settings, trainer.setup.env
    cycles = settings.epochs * settings.cycles_per_epoch
    steps = settings.environments * env.episode_length
    totals = {"env_steps": cycles * steps, "updates": cycles * settings.updates_per_cycle}
    for name, count in totals.items():
        if count >= 2**31:
            raise SettingError(f"epochs: {count:,} {name} in all are more than can be counted")


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
        OSError: metrics, or a job's last checkpoint, cannot be written.
        SettingError: a checkpoint holds the state of another program.
    """
    rows, last = [], []
    shard = directory.shard()
    swept = shard.swept if shard else swept_settings([job.group for job in jobs])
    for index, job in enumerate(jobs):
        progress.compiling()
        job, training = _begin(job, index, directory, compiler)
        _keep_lost_metrics(training, index, directory, rows)
        directory.replace_metrics(rows + training.rows)
        settings = job.group.settings
        progress.skip(training.epoch * settings.cycles_per_epoch + training.cycle)
        recorder = Recorder(
            directory, job.group, index, training.rows, checkpoint_seconds, swept, tracking
        )
        if not _train(job, training, recorder, progress, interruption):
            return None
        progress.skip((settings.epochs - training.epoch) * settings.cycles_per_epoch)
        tracking.end()
        rows += training.rows
        last += training.rows[-len(job.group.runs) :]
    return last


def check_last_checkpoints(jobs: Sequence[Job], directory: RunDirectory) -> None:
    """Check the jobs' last checkpoints before anything is recorded of resuming from them.

    Raises:
        SettingError: one holds the state of another program, or is of another version.
    """
    for index, job in enumerate(jobs):
        check_last_checkpoint(directory.path / "checkpoints", index, _shapes(job))


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
        except (KeyError, ValueError) as error:
            raise SettingError(f"resume: a checkpoint holds rows of other runs: {error}") from None
    where = f"resuming after epoch {training.epoch}" if training else "starting from the beginning"
    for note in notes:
        print(f"{note}; {where}", file=sys.stderr)
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
            if (start := start_beside(directory.path / CONFIG)) is not None:
                filled_up = job.programs.spread(hyper)
                warm = start_from(read_source(start), job.programs, filled_up, state)
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


def _keep_lost_metrics(
    training: TrainingProgress, index: int, directory: RunDirectory, rows: Sequence[Row]
) -> None:
    """Say that a group begins anew, and set metrics aside that would be lost by that.

    Args:
        training: how far the group has trained.
        index: its number.
        directory: what an earlier process has written, if there was one.
        rows: what groups before this one have written.
    """
    lines = directory.count_metrics()
    if training.epoch or training.cycle or lines is None or (index and lines <= len(rows)):
        return
    note = f"no checkpoint of group {index}: it begins anew"
    if lines > len(rows):
        note += f", and the metrics until now are kept as {directory.set_metrics_aside()}"
    print(note, file=sys.stderr)


def _train(
    job: Job,
    training: TrainingProgress,
    recorder: Recorder,
    progress: SweepProgress,
    interruption: Interruption,
) -> bool:
    """Train a job, chunk by chunk, to its end (true) or until a signal comes (false)."""
    settings, programs = job.group.settings, job.programs
    hyper = job.group.hyper()
    began, pace = time.monotonic() - training.wall_s, Pace()
    with watchdog() as something_happened:
        while not _is_finished(job.group, training):
            if training.cycle < settings.cycles_per_epoch:
                _train_chunk(job, training, hyper, pace, progress)
                training.wall_s = time.monotonic() - began
            else:
                metrics = _close_epoch(programs, training, hyper, pace, progress)
                training.wall_s = time.monotonic() - began
                progress.epoch(training.epoch, recorder.record_epoch(training, metrics))
            interruption.expendable = False
            something_happened()
            if _is_finished(job.group, training):
                recorder.save(training)
                continue
            # A signal does not wait for what it could not wait for: that begins with a checkpoint.
            must = interruption.requested or _may_outlast_patience(job, training, recorder, pace)
            saved = recorder.try_to_save(training) if must else recorder.save_if_due(training)
            if interruption.requested and (must or saved):
                return False
            interruption.expendable = must and saved
    interruption.expendable = True
    return not interruption.requested


def _may_outlast_patience(
    job: Job, training: TrainingProgress, recorder: Recorder, pace: Pace
) -> bool:
    """Whether what comes next may take longer than a signal can wait, with a checkpoint after it.

    Where checkpoints take long it is said less often than it is so: a fifth of the time is enough.
    Of an evaluation that is the first of this process nothing is known. It is taken for as long as
    the cycles before it, which would be lost; and for longer than patience while it compiles, if
    more than a chunk would be lost.
    """
    if recorder.unsaved_seconds() < 4 * recorder.save_seconds:
        return False
    patience = PATIENCE_SECONDS - recorder.save_seconds
    if training.cycle < job.group.settings.cycles_per_epoch:
        return (pace.cycle or 0.0) > patience
    if pace.evaluation is not None:
        return pace.evaluation > patience
    at_risk = training.cycle * (pace.cycle or 0.0)
    return at_risk > (CHUNK_SECONDS if is_compiling(job.programs.evaluate) else patience)


def _is_finished(group: Group, training: TrainingProgress) -> bool:
    """Whether all epochs are done, or all runs hold the success at which they may leave."""
    settings, rates = group.settings, [row["success_rate"] for row in training.rows]
    leave_at = None if training.cycle else settings.leave_at
    return have_finished(rates, len(group.runs), training.epoch, settings.epochs, leave_at)


def _train_chunk(
    job: Job,
    training: TrainingProgress,
    hyper: Hyperparameters,
    pace: Pace,
    progress: SweepProgress,
) -> None:
    settings, env = job.group.settings, job.programs.trainer.setup.env
    cycles = pace.next_chunk(settings.cycles_per_epoch - training.cycle)
    with device_errors():
        if pace.cycle is None:
            wait_for(job.programs.train)
        began = time.monotonic()
        training.state = jax.block_until_ready(job.programs.train(training.state, hyper, cycles))
    seconds = time.monotonic() - began
    pace.record(cycles, seconds)
    training.cycle += cycles
    steps_per_cycle = settings.environments * env.episode_length
    progress.advance(cycles, cycles * steps_per_cycle * len(job.group.runs), seconds)


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
    pace.evaluation = time.monotonic() - began
    training.epoch, training.cycle = training.epoch + 1, 0
    return metrics
