"""From what is asked for to an exit code: what sweep and train have in common."""

import itertools
import sys
from collections.abc import Sequence
from contextlib import ExitStack
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING

from cgm_jax.host.asked import Asked
from cgm_jax.host.command_line import (
    bring_config_back,
    owns_process,
    print_error,
    remark_on_repeated,
)
from cgm_jax.host.conclusion import exit_code_of, show_results, try_to_draw_figures
from cgm_jax.host.exit_codes import ExitCode
from cgm_jax.host.interruption import STOPPED_AT_ONCE, Interruption
from cgm_jax.host.progress import SweepProgress, physics_lines, summary_lines
from cgm_jax.host.to_train import find_to_train, record
from cgm_jax.host.training_options import TrainingOptions
from cgm_jax.machine.commands import shell_command
from cgm_jax.machine.device_errors import DeviceError
from cgm_jax.results.tracking import Tracking, find_tracker
from cgm_jax.storage.checkpoints import holds_config
from cgm_jax.storage.files import ReadError, refusal
from cgm_jax.storage.looking import check_place
from cgm_jax.storage.run_directory import RunDirectory, claiming

if TYPE_CHECKING:  # jobs imports JAX
    from cgm_jax.host.jobs import Job
    from cgm_jax.loop.compiler import Compiler

RUNS = Path("runs")
"""In which a directory is made where none is named."""


def train_groups(options: TrainingOptions, asked: Asked, command: Sequence[str]) -> int:
    """Train groups of runs, from the beginning or from where they were stopped.

    Args:
        options: where to, and how often to write checkpoints.
        asked: what to train.
        command: that asks for it, which a new sweep records.

    Returns:
        The exit code.

    Raises:
        SettingError: before anything compiles, if something cannot be as it is asked for.
        InUseError: before anything compiles, if another process trains in the directory.
    """
    with Interruption(ends_process=owns_process()) as interruption, ExitStack() as shown:
        progress = shown.enter_context(SweepProgress())
        if options.track is not None:
            find_tracker(options.track)
        try:
            return _train_as_asked(options, asked, command, interruption, shown, progress)
        except ReadError as error:
            return _refused(error, options, options.resume or options.out)


def _train_as_asked(
    options: TrainingOptions,
    asked: Asked,
    command: Sequence[str],
    interruption: Interruption,
    shown: ExitStack,
    progress: SweepProgress,
) -> int:
    """Train groups of runs, see `train_groups`.

    Raises:
        SettingError, InUseError: as there.
        ReadError: a file cannot be read just now.
    """
    out = options.resume or options.out
    if options.out is not None:
        check_place("out", options.out)
    if out is not None and not options.dry_run:
        try:
            bring_config_back(out)
        except OSError as error:
            return _refused(error, options, out)
    to_train = find_to_train(options, asked, out)
    remark_on_repeated()
    if options.dry_run:
        from cgm_jax.host.dry_run import show_plan

        shown.close()
        directory = RunDirectory(out) if to_train.recorded and out else None
        return show_plan(to_train.jobs, to_train.notes, directory)
    from cgm_jax.loop.compiler import Compiler

    try:
        out = out or new_directory(asked.preset)
        with (
            Compiler() as compiler,  # which is waited for when all else is done
            RunDirectory.claimed(out, fresh=to_train.recorded is None) as directory,
        ):
            notes = to_train.notes + record(directory, to_train, asked, command)
            print(f"{out}: {'; '.join(notes)}", file=sys.stderr)
            how = _how_to_resume(out, options.track)
            interruption.last_words = f"{STOPPED_AT_ONCE}; {how}"
            # Not before there is a config, without which what it writes would be in the way.
            with Tracking(options.track, out) as tracking:
                return _train(
                    to_train.jobs,
                    directory,
                    interruption,
                    options,
                    shown,
                    progress,
                    tracking,
                    compiler,
                )
    except OSError as error:
        return _refused(error, options, out)


def _refused(error: OSError, options: TrainingOptions, out: Path | None) -> int:
    """Say what the system has refused, and how to go on; return the exit code."""
    print_error(refusal(error, out or RUNS))
    begun = options.resume is not None
    if out is not None and not begun:  # a lost config may not have come back
        begun = RunDirectory(out).holds_sweep() or holds_config(out / "checkpoints")
    what_now = _how_to_resume(out, options.track) if begun and out else "nothing was begun"
    print(what_now, file=sys.stderr)
    return ExitCode.CANNOT_WRITE


def new_directory(preset: str) -> Path:
    """Make a directory named for the time, which nobody else gets, however many start at once.

    Raises:
        SettingError: it cannot be made.
        OSError: the disk is full or read-only, or fails.
    """
    first = RUNS / f"{preset}-{datetime.now():%Y%m%d-%H%M%S}"
    names = itertools.chain([first], (Path(f"{first}-{number}") for number in itertools.count(2)))
    with claiming(first):
        first.parent.mkdir(exist_ok=True)
        return next(path for path in names if _made(path))


def _made(path: Path) -> bool:
    """Whether this process has made the directory, which until now was not there."""
    try:
        path.mkdir()
    except FileExistsError:
        return False
    return True


def _train(
    jobs: "Sequence[Job]",
    directory: RunDirectory,
    interruption: Interruption,
    options: TrainingOptions,
    shown: ExitStack,
    progress: SweepProgress,
    tracking: Tracking,
    compiler: "Compiler",
) -> int:
    """Train, and say and draw what came of it.

    Args:
        jobs: what to train.
        directory: where to.
        interruption: says when to stop.
        options: how often to write checkpoints, and whether to write a table.
        shown: what is on the terminal until training ends.
        progress: part of that.
        tracking: is told of every epoch.
        compiler: compiles their programs.
    """
    from cgm_jax.host.runner import run_jobs

    progress.expect(
        sum(job.group.settings.epochs * job.group.settings.cycles_per_epoch for job in jobs)
    )
    try:
        with shown:
            seconds = options.checkpoint_seconds
            rows = run_jobs(jobs, directory, progress, interruption, seconds, tracking, compiler)
    except DeviceError as error:
        print_error(error)
        print(_how_to_resume(directory.path, tracking.name), file=sys.stderr)
        return ExitCode.FAILED
    if rows is None:
        interruption.last_words = None  # the line that follows is the last one
        print(f"stopped; {_how_to_resume(directory.path, tracking.name)}", file=sys.stderr)
    else:
        print("\n".join(summary_lines(rows) + physics_lines(directory.metrics())))
        print(f"{progress.seconds():.0f} s; figures in {directory.path / 'figures'}")
    figures = try_to_draw_figures(directory)
    if rows is not None and tracking.name is not None:
        show_results(directory, rows, figures, tracking)
    if options.csv or directory.has_csv():
        directory.write_csv()
    return ExitCode.STOPPED if rows is None else exit_code_of(rows)


def _how_to_resume(out: Path, tracker: str | None) -> str:
    track = [] if tracker is None else ["--track", tracker]
    return f"to resume: {shell_command('cgm_jax.sweep', '--resume', out, *track)}"
