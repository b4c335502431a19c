"""`python -m cgm_jax.report DIR [DIR ...]`: sweeps as one HTML file, to be read in any browser.

`--follow` writes it again whenever there is something new, until training has ended.
"""

import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from cgm_jax.config.fields import SettingError
from cgm_jax.host.command_line import owns_process, parse, print_restored, run_program
from cgm_jax.host.exit_codes import ExitCode
from cgm_jax.host.interruption import Interruption
from cgm_jax.machine.commands import shell_command
from cgm_jax.storage.looking import is_directory, look_at

if TYPE_CHECKING:
    from cgm_jax.results.page.sweeps import Sweep

NAME = "report.html"

LOOK_SECONDS = 2.0
"""Between two looks at the metrics of a sweep that is followed."""

RELOAD_SECONDS = 10.0
"""Between two looks of an open page at its own file."""

FileStamps = list[tuple[int, int] | None]
"""Sizes and times of files, None for one that is not there."""


@dataclass(kw_only=True)
class ReportOptions:
    """Write a page about sweeps: one HTML file that needs no network."""

    directories: Annotated[
        tuple[Path, ...],
        tyro.conf.Positional,
        tyro.conf.arg(metavar="DIR [DIR ...]", help_behavior_hint=""),
    ]
    """Directories that sweeps or training runs have written."""

    out: Path | None = None
    """The file to write (default: report.html in the first directory)."""

    follow: bool = False
    """Write it again whenever there is something new, until training has ended."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the program on command-line arguments; return its exit code.

    Raises:
        SettingError: input is refused.
        SystemExit: an argument is no option, or asks for help.
    """
    options = parse(ReportOptions, arguments, "python -m cgm_jax.report")
    _check(options)
    out = options.out or options.directories[0] / NAME
    with Interruption(
        ends_process=owns_process(), first_words="stopping", last_words="stopped"
    ) as interruption:
        seen = _state(options.directories)  # before it is read: what comes later is new
        sweeps = _read(options.directories)
        remarks = [_remark(sweep) for sweep in sweeps if sweep.lacks_rows]
        if not options.follow and not any(sweep.runs for sweep in sweeps):
            empty = f"{options.directories[0]} has no finished epoch yet; try --follow"
            raise SettingError(remarks[0] if remarks else empty)
        for remark in remarks:
            print(remark, file=sys.stderr)
        _write(out, sweeps, options.follow)
        print(out, flush=True)
        if not options.follow:
            return ExitCode.DONE
        return _follow(options, out, sweeps, seen, interruption)


def _check(options: ReportOptions) -> None:
    """Check what can be checked without reading.

    Raises:
        SettingError: no directory, one twice, one that cannot be looked at, or a file that cannot
            be written.
    """
    if not options.directories:
        raise SettingError("directories: name at least one")
    for path in options.directories:
        look_at("directories", path)
    resolved = [path.resolve() for path in options.directories]
    for path in options.directories:
        if resolved.count(path.resolve()) > 1:
            raise SettingError(f"directories: {path} is named twice")
    if options.out is None:
        return
    if is_directory("out", options.out):
        raise SettingError(f"out: {options.out} is a directory")
    if not is_directory("out", options.out.parent):
        raise SettingError(f"out: {options.out.parent} is no directory")


def _read(paths: Sequence[Path]) -> "list[Sweep]":
    from cgm_jax.results.page.sweeps import read_sweep

    for path in paths:
        print_restored(path)
    return [read_sweep(path) for path in paths]


def _remark(sweep: "Sweep") -> str:
    """What to say of a sweep that lacks rows."""
    from cgm_jax.storage.layout import METRICS

    command = shell_command("cgm_jax.sweep", "--resume", sweep.path)
    return f"{sweep.path / METRICS} lacks epochs that a checkpoint has; to restore them: {command}"


def _write(out: Path, sweeps: "Sequence[Sweep]", follows: bool) -> None:
    from cgm_jax.results.page.page import write_page

    try:
        write_page(out, sweeps, RELOAD_SECONDS if follows else None)
    except OSError as error:
        raise SettingError(f"out: cannot write {out}: {error.strerror}") from None


def _follow(
    options: ReportOptions,
    out: Path,
    sweeps: "Sequence[Sweep]",
    seen: FileStamps,
    interruption: Interruption,
) -> int:
    """Write the page again whenever metrics change; a last time, without reloading, at the end."""
    interruption.expendable = False  # a page may be half written
    print("following; Ctrl-C ends it", file=sys.stderr)
    while not all(sweep.finished for sweep in sweeps):
        if interruption.requested:
            _write(out, sweeps, follows=False)
            return ExitCode.STOPPED
        time.sleep(LOOK_SECONDS)
        if (state := _state(options.directories)) != seen:
            seen, sweeps = state, _read(options.directories)
            _write(out, sweeps, follows=True)
    _write(out, sweeps, follows=False)
    return ExitCode.DONE


def _state(paths: Sequence[Path]) -> FileStamps:
    """What tells whether files have changed: sizes and times of configs and metrics."""
    from cgm_jax.storage.layout import CONFIG, METRICS

    found: FileStamps = []
    for file in (path / name for path in paths for name in (CONFIG, METRICS)):
        try:
            status = file.stat()
            found.append((status.st_size, status.st_mtime_ns))
        except OSError:
            found.append(None)
    return found


if __name__ == "__main__":
    run_program(main)
