"""`python -m cgm_jax.launch --on local|slurm|ray --jobs N -- SWEEP OPTIONS`: a sweep in parts."""

import contextlib
import sys
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

from cgm_jax.config.grid import Group
from cgm_jax.config.shards import piece
from cgm_jax.host.command_line import (
    bring_config_back,
    owns_process,
    parse,
    print_error,
    remark_on_repeated,
    run_program,
)
from cgm_jax.host.conclusion import conclude
from cgm_jax.host.exit_codes import FINISHED, ExitCode
from cgm_jax.host.interruption import Interruption
from cgm_jax.host.session import RUNS, new_directory
from cgm_jax.launching.check import check_sweep
from cgm_jax.launching.directory import ANY_CLUSTER, Launch, absolute_path
from cgm_jax.launching.merged import is_merged
from cgm_jax.launching.plan import PROGRAM, LaunchOptions, check_separated, planned
from cgm_jax.launching.supervision import PATIENCE_SECONDS, Engine, supervise, verdict
from cgm_jax.machine.commands import begun_with, shell_command
from cgm_jax.results.merged_provenance import differences
from cgm_jax.results.merging import write_merged
from cgm_jax.results.parts import read_parts
from cgm_jax.storage.files import refusal
from cgm_jax.storage.layout import LAUNCH
from cgm_jax.storage.looking import check_place, is_there
from cgm_jax.storage.run_directory import RunDirectory, claiming


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the program on command-line arguments; return its exit code.

    Raises:
        SettingError: input is refused.
        InUseError: another process works in the directory.
        SystemExit: an argument is no option, or asks for help.
    """
    words = list(sys.argv[1:] if arguments is None else arguments)
    place = words.index("--") if "--" in words else len(words)
    check_separated(words[:place])
    options = parse(LaunchOptions, words[:place], PROGRAM)
    launch, groups = planned(options, words[place + 1 :])
    fresh = launch.path == Path() or not is_there("out", launch.path / LAUNCH)
    engine = _engine(launch)
    if fresh:
        if launch.path != Path():
            # Which the rest takes minutes to come to.
            check_place("out", launch.path)
            RunDirectory(launch.path).check_fresh(also=("parts", "attempts", "logs"))
        engine.check()
        check_sweep(launch.sweep, engine.variables_here())
    remark_on_repeated()
    # Only now, since Ray puts signal handlers of its own in the place of others when it starts.
    with (
        Interruption(
            patience=PATIENCE_SECONDS + 5,
            ends_process=owns_process(),
            first_words="stopping; a second Ctrl-C: at once",
        ) as interruption,
        contextlib.ExitStack() as claimed,
    ):
        try:
            if launch.path == Path():
                launch = replace(launch, path=absolute_path(new_directory(launch.preset)))
            if not fresh:
                bring_config_back(launch.path)  # of a launch that was merged
            directory, merged = claimed.enter_context(_claimed(launch, fresh=fresh))
        except OSError as error:
            return _refused(error, launch, begun=not fresh)
        if merged:
            return conclude(directory, directory.checked_metrics())
        interruption.expendable = False
        command = begun_with("cgm_jax.launch", words)
        try:
            return _run(launch, engine, groups, directory, interruption, command)
        except OSError as error:
            return _refused(error, launch, begun=True)


def _engine(launch: Launch) -> Engine:
    """What makes attempts, before anything is made.

    Raises:
        SettingError: it is not installed, or there is no such thing here.
    """
    if launch.on == "slurm":
        from cgm_jax.launching.slurm import Slurm

        return Slurm(launch.resources)
    if launch.on == "ray":
        from cgm_jax.launching.ray import Ray

        return Ray(launch.resources)
    from cgm_jax.launching.local import Local

    return Local(launch.parts, launch.resources)


@contextlib.contextmanager
def _claimed(launch: Launch, *, fresh: bool) -> Iterator[tuple[RunDirectory, bool]]:
    """The launch's directory, in which no other launcher is meanwhile; and whether it is merged.

    Raises:
        SettingError: it cannot be written to, or holds something else.
        OSError: the disk fails, or it served before and cannot be written to.
        InUseError: another launcher has it.
    """
    with RunDirectory.claimed(launch.path, fresh=fresh) as directory:
        merged = is_merged(directory)
        with claiming(launch.path, fresh=fresh):
            launch.write()
        yield directory, merged


def _refused(error: OSError, launch: Launch, *, begun: bool) -> int:
    """Say what the system has refused, and how to go on; return the exit code."""
    place = RUNS if launch.path == Path() else launch.path
    print_error(refusal(error, place))
    print(_how_to_resume(launch) if begun else "nothing was begun", file=sys.stderr)
    return ExitCode.CANNOT_WRITE


def _run(
    launch: Launch,
    engine: Engine,
    groups: Sequence[Group],
    directory: RunDirectory,
    interruption: Interruption,
    command: Sequence[str],
) -> int:
    """Train all parts and merge them.

    Raises:
        SettingError: parts are not what was launched.
        OSError: what they have written cannot be read just now, or the merged sweep not be written.
    """
    runs = sum(len(group.runs) for group in groups)
    print(f"{launch.path}: {runs} runs in {launch.parts} parts, {launch.on}", file=sys.stderr)
    codes = supervise(launch, engine, _epochs(launch, groups), interruption)
    if codes is None:
        print(f"stopped; {_how_to_resume(launch)}", file=sys.stderr)
        return ExitCode.STOPPED
    failed = [part for part, code in codes.items() if code not in FINISHED]
    if failed:
        which = ", ".join(str(part) for part in sorted(failed))
        print(f"not done: {len(failed)} of {launch.parts} parts ({which})", file=sys.stderr)
        print(_how_to_resume(launch), file=sys.stderr)
        return verdict(codes)
    parts = read_parts([launch.out(part) for part in codes])
    if names := differences(parts):
        print(f"bits may differ: parts differ in {', '.join(names)}", file=sys.stderr)
    return conclude(directory, write_merged(parts, directory, command))


def _epochs(launch: Launch, groups: Sequence[Group]) -> dict[int, int]:
    """Epochs of all runs of each part, added up."""
    return {
        part: sum(
            len(group.runs) * group.settings.epochs for group in piece(groups, part, launch.parts)
        )
        for part in range(1, launch.parts + 1)
    }


def _how_to_resume(launch: Launch) -> str:
    address = launch.resources.address
    named = ["--address", address] if launch.on == "ray" and address != ANY_CLUSTER else []
    return f"to resume: {shell_command('cgm_jax.launch', '--resume', launch.path, *named)}"


if __name__ == "__main__":
    run_program(main)
