"""From groups of runs to an exit code: what sweep and train have in common."""

import dataclasses
import itertools
import sys
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from cgm_jax.config.components import NAMES
from cgm_jax.config.fields import SettingError
from cgm_jax.config.grid import Group
from cgm_jax.config.shards import Shard
from cgm_jax.host.asked import Asked
from cgm_jax.host.command_line import TrainingOptions, bring_config_back, owns_process
from cgm_jax.host.conclusion import exit_code_of, show_results, try_to_draw_figures
from cgm_jax.host.devices import (
    check_devices,
    cpu_devices,
    describe_devices,
    parse_devices,
)
from cgm_jax.host.differences import check_same, check_unchanged
from cgm_jax.host.exit_codes import ExitCode
from cgm_jax.host.extension import extended
from cgm_jax.host.interruption import STOPPED_AT_ONCE, Interruption
from cgm_jax.host.progress import SweepProgress, physics_lines, summary_lines
from cgm_jax.host.startup import prepare_jax
from cgm_jax.machine.commands import shell_command
from cgm_jax.machine.device_errors import DeviceError
from cgm_jax.results.tracking import Tracking, find_tracker
from cgm_jax.storage.checkpoints import holds_config
from cgm_jax.storage.config_file import read_origin
from cgm_jax.storage.files import ReadError, refusal
from cgm_jax.storage.layout import CONFIG
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
    out, moved = options.resume or options.out, {}
    if options.out is not None:
        check_place("out", options.out)
    if out is not None and not options.dry_run:
        try:
            bring_config_back(out)
        except OSError as error:
            return _refused(error, options, out)
    if asked.groups is None and out is not None:
        # What own code the user names goes with what the directory holds.
        named = {kind: asked.chosen.get(kind, ()) for kind in NAMES}
        moved = RunDirectory.open(out).config.moved(named)
    recorded = None if out is None else _recorded_groups(out, asked, moved)
    to_train, devices = recorded or asked.groups or [], parse_devices(options.devices)
    jobs, notes = plan(to_train, devices, planned=recorded is not None)
    start = None if recorded else _start(asked, jobs)
    if options.dry_run:
        from cgm_jax.host.dry_run import show_plan

        shown.close()
        return show_plan(jobs, notes, RunDirectory(out) if recorded and out else None)
    from cgm_jax.loop.compiler import Compiler

    try:
        out = out or new_directory(asked.preset)
        with (
            Compiler() as compiler,  # which is waited for when all else is done
            RunDirectory.claimed(out, fresh=recorded is None) as directory,
        ):
            device = describe_devices()
            if recorded is None:
                if start is not None:
                    directory.write_start(start)
                groups = [job.group for job in jobs]
                directory.config.write(
                    groups, asked.preset, device, asked.shard, asked.origin, command
                )
            else:
                notes += _notes_on_resuming(directory, jobs, device, recorded, moved)
                _record_shard(directory, asked.shard)
            print(f"{out}: {'; '.join(notes)}", file=sys.stderr)
            how = _how_to_resume(out, options.track)
            interruption.last_words = f"{STOPPED_AT_ONCE}; {how}"
            # Not before there is a config, without which what it writes would be in the way.
            with Tracking(options.track, out) as tracking:
                return _train(
                    jobs, directory, interruption, options, shown, progress, tracking, compiler
                )
    except OSError as error:
        return _refused(error, options, out)


def _refused(error: OSError, options: TrainingOptions, out: Path | None) -> int:
    """Say what the system has refused, and how to go on; return the exit code."""
    print(f"error: {refusal(error, out or RUNS)}", file=sys.stderr)
    begun = options.resume is not None
    if out is not None and not begun:  # a lost config may not have come back
        begun = RunDirectory(out).holds_sweep() or holds_config(out / "checkpoints")
    what_now = _how_to_resume(out, options.track) if begun and out else "nothing was begun"
    print(what_now, file=sys.stderr)
    return ExitCode.CANNOT_WRITE


def plan(
    groups: Sequence[Group],
    devices: int | None,
    *,
    planned: bool = False,
    on_this_machine: bool = True,
) -> "tuple[list[Job], list[str]]":
    """Start JAX, and build what groups need; see `jobs.plan_jobs`.

    Args:
        groups: of runs.
        devices: how many share the runs; None for all.
        planned: whether memory was planned before.
        on_this_machine: whether devices and memory are to be those of this machine.

    Raises:
        SettingError: something cannot be as it is asked for.
    """
    sharing = cpu_devices(devices, groups)
    prepare_jax(sharing)
    import jax

    from cgm_jax.host.jobs import plan_jobs

    if on_this_machine:
        check_devices(devices)
    planned = planned or not on_this_machine
    # Of a CPU there may be one more, which is to be idle; see `prepare_jax`.
    count = sharing if jax.default_backend() == "cpu" else devices
    return plan_jobs(groups, jax.devices()[:count], planned=planned)


def _start(asked: Asked, jobs: "Sequence[Job]") -> dict[str, np.ndarray] | None:
    """What jobs start from, which fits all of them; None for from scratch.

    Raises:
        SettingError: there is nothing to start from, or it does not fit.
    """
    from cgm_jax.host.warm_start import check_start, read_source

    if asked.start is None:
        return None
    start = read_source(asked.start, asked.start_run)
    for job in jobs:
        check_start(start, job.programs, job.group.hyper())
    return start


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


def _recorded_groups(out: Path, asked: Asked, moved: Mapping[str, str]) -> list[Group] | None:
    """What the directory holds, as it was split, for the epochs that are asked for.

    Args:
        out: the directory.
        asked: what is asked for.
        moved: environments that have been named again, see `SweepConfig.moved`.

    Returns:
        Its groups; None if it is new.

    Raises:
        SettingError: it holds something else than what is asked for.
    """
    directory = RunDirectory(out)
    if asked.groups is None:
        recorded = RunDirectory.open(out).config.groups(moved)
        check_unchanged(out, recorded, asked.chosen)
        return extended(directory, recorded, asked.chosen)
    if not directory.holds_sweep():
        directory.check_fresh()
        return None
    if (before := read_origin(directory.path / CONFIG)) != asked.origin:
        now, then = asked.origin or "nothing", before or "nothing"
        raise SettingError(f"from: {out} was begun from {then}, not from {now}")
    recorded = directory.config.groups()
    shard = directory.config.shard()
    if shard != asked.shard and (shard is None or shard != asked.former_shard):
        raise SettingError(f"out: {out} already holds another part, or a whole sweep")
    check_same(out, recorded, asked.groups)
    return recorded


def _notes_on_resuming(
    directory: RunDirectory,
    jobs: "Sequence[Job]",
    device: str,
    groups: Sequence[Group],
    moved: Mapping[str, str],
) -> list[str]:
    """Check that jobs can resume, record what differs, and say so.

    Raises:
        SettingError, ReadError: a checkpoint is refused, or what a job starts from; then nothing is
            recorded.
    """
    from cgm_jax.host.runner import check_last_checkpoints, check_starts

    notes, epochs = ["resuming where it was stopped"], None
    changed = directory.config.changes_since_begun(device, groups, moved)
    try:
        check_last_checkpoints(jobs, directory)
    except SettingError as error:
        reason = f"; it was begun with {', '.join(changed)}" if changed else ""
        raise SettingError(f"{error}{reason}") from None
    check_starts(jobs, directory)
    if changed:
        notes.append(f"bits may differ, since it was begun with {', '.join(changed)}")
    before, now = (one[0].settings.epochs for one in (directory.config.groups(moved), groups))
    if before != now:
        epochs = now
        notes.append(f"{now} epochs instead of {before}")
        changed.append(f"epochs {before} (now {now})")
    directory.config.record_resumption(changed, moved, epochs)
    return notes


def _record_shard(directory: RunDirectory, shard: Shard | None) -> None:
    """Record which part a directory holds as this version does, so that it merges with new ones.

    Args:
        directory: of a part, or of a whole sweep.
        shard: what was asked for; None if that was not said.

    Raises:
        OSError: it cannot be written.
    """
    if shard is not None and directory.config.shard() != shard:
        directory.config.replace({**directory.config.read(), "shard": dataclasses.asdict(shard)})


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
        print(f"error: {error}", file=sys.stderr)
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
