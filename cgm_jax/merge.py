"""`python -m cgm_jax.merge DIR... --out DIR`: one directory from the parts of a sweep."""

import contextlib
import shutil
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from cgm_jax.config.fields import SettingError
from cgm_jax.host.command_line import (
    bring_config_back,
    owns_process,
    parse,
    print_error,
    run_program,
)
from cgm_jax.host.conclusion import conclude
from cgm_jax.host.exit_codes import ExitCode
from cgm_jax.host.interruption import Interruption
from cgm_jax.machine.commands import begun_with
from cgm_jax.results.merged_provenance import differences
from cgm_jax.results.merging import write_merged
from cgm_jax.results.parts import read_parts
from cgm_jax.storage.files import ReadError, refusal
from cgm_jax.storage.looking import is_there, look_at
from cgm_jax.storage.run_directory import RunDirectory, claiming


@dataclass(kw_only=True)
class MergeOptions:
    """Put the parts of a sweep, trained with --shard I/N, together in one directory.

    It is as if the sweep had been trained in one: metrics, policies, checkpoints, config and
    figures. The parts stay as they are.
    """

    directories: Annotated[tuple[Path, ...], tyro.conf.Positional] = ()
    """Directories of all parts, in any order."""

    out: Annotated[Path | None, tyro.conf.arg(metavar="DIR", help_behavior_hint="(required)")] = (
        None
    )
    """Directory to make."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the program on command-line arguments; return its exit code.

    Raises:
        SettingError: input is refused.
        SystemExit: an argument is no option, or asks for help.
    """
    options = parse(MergeOptions, arguments, "python -m cgm_jax.merge")
    out = options.out
    if out is None or out == Path():
        raise SettingError("out: name the directory to make")
    with Interruption(ends_process=owns_process(), first_words="stopping", last_words="stopped"):
        if is_there("out", out) or out.is_symlink():
            raise SettingError(f"out: {out} exists already; name another directory")
        for path in options.directories:
            look_at("directories", path)
            try:
                bring_config_back(path)
            except OSError as error:
                return _refused(error, path)
        try:
            parts = read_parts(options.directories)
        except ReadError as error:
            return _refused(error, out)
        if names := differences(parts):
            print(f"bits may differ: parts differ in {', '.join(names)}", file=sys.stderr)
        # Made beside and then renamed, so that `out` is whole or not there.
        making = out.parent / f".{out.name}.merging"
        try:
            with claiming(out):
                making.mkdir(parents=True, exist_ok=True)
            with RunDirectory.claimed(making, fresh=False) as directory:
                rows = write_merged(parts, directory, begun_with("cgm_jax.merge", arguments))
            making.rename(out)
        except OSError as error:
            with contextlib.suppress(OSError):
                shutil.rmtree(making)
            return _refused(error, out)
        return conclude(RunDirectory(out), rows)


def _refused(error: OSError, directory: Path) -> int:
    """Say what the system has refused; return the exit code."""
    print_error(refusal(error, directory))
    return ExitCode.CANNOT_WRITE


if __name__ == "__main__":
    run_program(main)
