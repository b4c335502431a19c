"""What a sweep would train and what it takes, without a directory: `--dry-run`.

The time is measured: each program is compiled and run for some cycles. Of a sweep that has been
trained for a while it is the pace that its metrics.jsonl recorded.
"""

import sys
import time
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import jax

from cgm_jax.config.grid import structure
from cgm_jax.config.spelling import counted
from cgm_jax.host.beginning import check_last_checkpoints
from cgm_jax.host.command_line import print_error
from cgm_jax.host.exit_codes import ExitCode
from cgm_jax.host.jobs import Job
from cgm_jax.loop.compiler import Compiler, wait_for
from cgm_jax.machine.device_errors import DeviceError, device_errors
from cgm_jax.storage.checkpoints import last_whole, position_of
from cgm_jax.storage.run_directory import RunDirectory
from cgm_jax.storage.untrusted import UNREADABLE

MEASURED_SECONDS = 2.0
"""For how long a program runs to be timed; at least one cycle."""

MAX_SHOWN = 20
"""Runs of a job that are listed."""

Key = tuple[object, int]
"""A program and how many runs it trains: jobs of one key take equally long per epoch."""


class Pace(NamedTuple):
    """Seconds that a job takes.

    Attributes:
        compiling: once per key.
        cycle: of rollouts and updates, each.
        evaluation: at the end of an epoch, each.
    """

    compiling: float
    cycle: float
    evaluation: float


def show_plan(jobs: Sequence[Job], notes: Sequence[str], directory: RunDirectory | None) -> int:
    """Print what would be trained; return the exit code.

    Args:
        jobs: what would be.
        notes: lines on memory, and remarks.
        directory: that would be resumed; None for a new one.

    Raises:
        SettingError: a checkpoint there is refused.
        ReadError: one cannot be read just now.
    """
    if directory is not None:
        check_last_checkpoints(jobs, directory)
    for line in (*_plan_lines(jobs), *notes):
        print(line, flush=True)
    try:
        print(_time_line(jobs, directory))
    except DeviceError as error:
        print_error(error)
        return ExitCode.FAILED
    return ExitCode.DONE


def _plan_lines(jobs: Sequence[Job]) -> Iterator[str]:
    count = sum(len(job.group.runs) for job in jobs)
    programs = len({_key(job)[0] for job in jobs})
    yield f"{counted(count, 'run')} in {counted(programs, 'program')}; nothing is written"
    for number, job in enumerate(jobs, 1):
        settings, runs, env = job.group.settings, job.group.runs, job.programs.trainer.setup.env
        steps = settings.environments * env.episode_length * settings.cycles_per_epoch
        components = f"{runs[0].values['curriculum']}, {runs[0].values['agent']}"
        yield (
            f"{number}. {settings.env}, {components}: {counted(len(runs), 'run')} side by side, "
            f"{counted(settings.epochs, 'epoch')} of {steps:,} environment steps each"
        )
        yield from (f"   {run.name}" for run in runs[:MAX_SHOWN])
        if len(runs) > MAX_SHOWN:
            yield f"   and {len(runs) - MAX_SHOWN} more"


def _time_line(jobs: Sequence[Job], directory: RunDirectory | None) -> str:
    """The time that is left, and what the estimate rests on."""
    recorded = {} if directory is None else _recorded_paces(jobs, directory)
    measured: dict[Key, Pace] = {}
    seconds, needed = 0.0, set[Key]()
    for index, job in enumerate(jobs):
        epochs, cycles = _left(job, index, directory)
        if epochs == 0:
            continue
        key = _key(job)
        if key not in recorded and key not in measured:
            print(f"measuring program {len(measured) + 1}", file=sys.stderr, flush=True)
            measured[key] = _measured(job)
        pace = (recorded | measured)[key]
        seconds += cycles * pace.cycle + epochs * pace.evaluation
        needed.add(key)
    if not needed:
        return "time: none, all is done"
    compiling = sum((recorded | measured)[key].compiling for key in needed)
    sources = ["as recorded there"] * bool(needed & set(recorded))
    sources += ["as measured just now"] * bool(measured)
    most = "at most " if any(job.group.settings.leave_at is not None for job in jobs) else ""
    return (
        f"time: {most}about {duration(seconds + compiling)}, {duration(compiling)} of it to "
        f"compile, {' or '.join(sources)}; other load and contact-rich episodes make it longer, "
        "checkpoints and figures come on top"
    )


def _measured(job: Job) -> Pace:
    """Compile a job's programs and time them in its first cycles.

    Raises:
        DeviceError: the physics or the memory fails.
    """
    hyper = job.group.hyper()
    with device_errors(), Compiler() as compiler:
        began = time.monotonic()
        programs = compiler.programs(job.programs, hyper)
        state = jax.block_until_ready(programs.start(hyper))
        for program in (programs.train, programs.evaluate):
            wait_for(program)
        compiling = time.monotonic() - began
        began, cycles = time.monotonic(), 0
        while not cycles or time.monotonic() - began < MEASURED_SECONDS:
            state = jax.block_until_ready(programs.train(state, hyper, job.parts.total))
            cycles += 1
        cycle, began = (time.monotonic() - began) / cycles, time.monotonic()
        jax.block_until_ready(programs.evaluate(state, hyper))
    return Pace(compiling, cycle, time.monotonic() - began)


def _recorded_paces(jobs: Sequence[Job], directory: RunDirectory) -> dict[Key, Pace]:
    """The paces of jobs that have been trained for a while, from metrics.jsonl.

    What the first epoch took longer than a later one is counted as compilation.
    """
    times: dict[str, list[float]] = {}
    try:
        for row in directory.metrics():
            times.setdefault(row["run"], []).append(float(row["wall_s"]))
    except (OSError, *UNREADABLE):  # damaged; checkpoints will restore it
        return {}
    paces = {}
    for job in jobs:
        first, *later = times.get(job.group.runs[0].name, [0.0])
        if later:
            epoch = (later[-1] - first) / len(later)
            cycle = epoch / job.group.settings.cycles_per_epoch
            paces[_key(job)] = Pace(max(0.0, first - epoch), cycle, evaluation=0.0)
    return paces


def _left(job: Job, index: int, directory: RunDirectory | None) -> tuple[int, int]:
    """Evaluations that a job has still to do, and cycles.

    Raises:
        SettingError, ReadError: a checkpoint is refused, or cannot be read just now.
    """
    settings, (epoch, cycle) = job.group.settings, (0, 0)
    if directory is not None:
        whole, damaged = last_whole(directory.path / "checkpoints", index)
        for path, complaint in damaged.items():
            print(f"{path} is damaged ({complaint}) and would be set aside", file=sys.stderr)
        epoch, cycle = position_of(whole)[:2] if whole else (0, 0)
    epochs = max(0, settings.epochs - epoch)
    return epochs, max(0, epochs * settings.cycles_per_epoch - cycle)


def _key(job: Job) -> Key:
    program = (id(job.programs), structure(job.group.settings, job.group.runs[0].hyper))
    return program, len(job.group.runs)


def duration(seconds: float) -> str:
    """A time for people, to two digits or so."""
    if seconds < 90:
        return f"{seconds:.0f} s"
    if seconds < 90 * 60:
        return f"{seconds / 60:.0f} min"
    return f"{seconds / 3600:.1f} h" if seconds < 48 * 3600 else f"{seconds / 86400:.1f} days"
