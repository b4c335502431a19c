"""From groups of runs to an exit code: what sweep and train have in common."""

import itertools
import sys
import time
from collections.abc import Mapping, Sequence
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cgm_jax.config.components import NAMES
from cgm_jax.config.fields import SettingError
from cgm_jax.config.grid import Group, Run, structure
from cgm_jax.config.settings import Settings
from cgm_jax.host.command_line import TrainingOptions, owns_process, shell_command
from cgm_jax.host.device_errors import DeviceError
from cgm_jax.host.devices import check_devices, cpu_devices, parse_devices
from cgm_jax.host.exit_codes import ExitCode
from cgm_jax.host.interruption import Interruption
from cgm_jax.host.startup import prepare_jax
from cgm_jax.storage.run_directory import RunDirectory

if TYPE_CHECKING:  # runner imports JAX
    from cgm_jax.host.runner import Job


def train_groups(options: TrainingOptions, preset: str, groups: Sequence[Group] | None) -> int:
    """Train groups of runs, from the beginning or from where they were stopped.

    Args:
        options: where to, and how often to write checkpoints.
        preset: recorded in the directory.
        groups: what to train; None for what `options.resume` holds.

    Returns:
        The exit code.

    Raises:
        SettingError: before anything compiles, if something cannot be as it is asked for.
        InUseError: before anything compiles, if another process trains in the directory.
    """
    out = options.resume or options.out
    with Interruption(ends_process=owns_process()) as interruption:
        moved = {}
        if out is not None and (restored := RunDirectory(out).restore_config()) is not None:
            print(restored, file=sys.stderr)
        if groups is None and out is not None:
            # What own code the user names goes with what the directory holds.
            named = {kind: getattr(options, kind) or () for kind in NAMES}
            moved = RunDirectory.open(out).moved(named)
        recorded = None if out is None else _recorded_groups(out, groups, moved)
        to_train, asked = recorded or groups or [], parse_devices(options.devices)
        prepare_jax(cpu_devices(asked, to_train))
        import jax

        from cgm_jax.host.runner import plan_jobs

        check_devices(asked)
        jobs, notes = plan_jobs(to_train, jax.devices()[:asked], planned=recorded is not None)
        out = out or _new_directory(preset)
        try:
            with RunDirectory.claimed(out, fresh=recorded is None) as directory:
                device = f"{len(jax.devices())} x {jax.devices()[0].device_kind}"
                if recorded is None:
                    directory.write_config([job.group for job in jobs], preset, device)
                else:
                    notes += _notes_on_resuming(directory, device, recorded, moved)
                print(f"{out}: {'; '.join(notes)}", file=sys.stderr)
                return _train(jobs, directory, interruption, options.checkpoint_seconds)
        except OSError as error:
            print(f"error: cannot write to {out}: {error.strerror or error}", file=sys.stderr)
            print(_how_to_resume(out), file=sys.stderr)
            return ExitCode.CANNOT_WRITE


def _new_directory(preset: str) -> Path:
    """Make a directory named for the time, which nobody else gets, however many start at once.

    Raises:
        SettingError: it cannot be made.
    """
    first = Path("runs") / f"{preset}-{datetime.now():%Y%m%d-%H%M%S}"
    names = itertools.chain([first], (Path(f"{first}-{number}") for number in itertools.count(2)))
    try:
        first.parent.mkdir(exist_ok=True)
        return next(path for path in names if _made(path))
    except OSError as error:
        raise SettingError(f"out: cannot write to {first}: {error.strerror}") from None


def _made(path: Path) -> bool:
    """Whether this process has made the directory, which until now was not there."""
    try:
        path.mkdir()
    except FileExistsError:
        return False
    return True


def _recorded_groups(
    out: Path, groups: Sequence[Group] | None, moved: Mapping[str, str]
) -> list[Group] | None:
    """What the directory holds, as it was split; None if it is new.

    Args:
        out: the directory.
        groups: what is asked for; None for what the directory holds.
        moved: environments that have been named again, see `RunDirectory.moved`.

    Raises:
        SettingError: it holds something else than what is asked for.
    """
    directory = RunDirectory(out)
    if groups is None:
        return RunDirectory.open(out).groups(moved)
    if not directory.holds_sweep():
        return None
    recorded = directory.groups()
    if _merged(recorded) != _merged(groups):
        raise SettingError(f"out: {out} already holds a sweep with other settings or runs")
    return recorded


def _merged(groups: Sequence[Group]) -> list[Group]:
    """Groups with parts of the same program put together again."""
    merged: dict[tuple[Settings, Any], list[Run]] = {}
    for group in groups:
        program = structure(group.settings, group.runs[0].hyper)
        merged.setdefault(program, []).extend(group.runs)
    return [Group(settings, tuple(runs)) for (settings, _), runs in merged.items()]


def _notes_on_resuming(
    directory: RunDirectory, device: str, groups: Sequence[Group], moved: Mapping[str, str]
) -> list[str]:
    notes = ["resuming where it was stopped"]
    if changed := directory.changes_since_begun(device, groups, moved):
        notes.append(f"bits may differ, since it was begun with {', '.join(changed)}")
        directory.record_resumption(changed, moved)
    return notes


def _train(
    jobs: "Sequence[Job]",
    directory: RunDirectory,
    interruption: Interruption,
    checkpoint_seconds: float,
) -> int:
    from cgm_jax.host.progress import SweepProgress, physics_lines, summary_lines
    from cgm_jax.host.runner import run_jobs

    started = time.monotonic()
    cycles = sum(job.group.settings.epochs * job.group.settings.cycles_per_epoch for job in jobs)
    try:
        with SweepProgress(cycles) as progress:
            rows = run_jobs(jobs, directory, progress, interruption, checkpoint_seconds)
    except DeviceError as error:
        print(f"error: {error}", file=sys.stderr)
        print(_how_to_resume(directory.path), file=sys.stderr)
        return ExitCode.FAILED
    if rows is None:
        print(f"stopped; {_how_to_resume(directory.path)}", file=sys.stderr)
    else:
        print("\n".join(summary_lines(rows) + physics_lines(directory.metrics())))
        print(f"{time.monotonic() - started:.0f} s; figures in {directory.path / 'figures'}")
    _draw_figures(directory)
    return ExitCode.STOPPED if rows is None else _verdict(rows)


def _draw_figures(directory: RunDirectory) -> None:
    """Draw what can be drawn; training is done, and its outcome does not depend on it."""
    try:
        from cgm_jax.results.figures import draw_figures

        draw_figures(directory)
    except Exception as error:
        line = str(error).partition("\n")[0]
        print(f"no figures drawn: {type(error).__name__}: {line}", file=sys.stderr)


def _verdict(rows: Sequence[Mapping[str, Any]]) -> int:
    """The exit code for the last row of every run; says which is not as it should be."""
    diverged = sum(row["failure"] is not None for row in rows)
    if diverged:
        print(f"{diverged} of {len(rows)} runs diverged", file=sys.stderr)
    dropped = sum(row["success_rate"] is None for row in rows)
    if dropped:
        print(
            f"{dropped} of {len(rows)} runs had no valid episode in their last evaluation",
            file=sys.stderr,
        )
    return ExitCode.DIVERGED if diverged or dropped else ExitCode.DONE


def _how_to_resume(out: Path) -> str:
    return f"to resume: {shell_command('cgm_jax.sweep', '--resume', out)}"
