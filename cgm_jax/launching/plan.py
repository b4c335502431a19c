"""What is to be launched, from options: a new sweep in parts, or one that was stopped."""

import importlib
import shlex
import sys
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro

from cgm_jax.config.components import NAMES, TRACK
from cgm_jax.config.fields import SettingError
from cgm_jax.config.grid import Group, build_groups
from cgm_jax.config.named import is_own, load_named, name_now, require_named
from cgm_jax.config.shards import MAX_PARTS
from cgm_jax.host.command_line import parse
from cgm_jax.host.training_options import chosen_values, seed_values
from cgm_jax.launching.directory import (
    ANY_CLUSTER,
    Launch,
    Resources,
    absolute_path,
    absolute_words,
    read_launch,
)
from cgm_jax.storage.layout import LAUNCH
from cgm_jax.storage.looking import is_there
from cgm_jax.sweep import SweepOptions

PROGRAM = "python -m cgm_jax.launch"
ENGINES = ("local", "slurm", "ray")
OWN = ("out", "resume", "shard")
"""Options of a sweep that a launch gives to its parts itself."""

RANGES = {
    "cores": (1, 10**4),
    "gpus": (0, 100),
    "memory": (0.1, 10**5),
    "minutes": (1, 10**6),
}
"""Of resources."""

OF_ONE_PLACE = {"minutes": "slurm", "sbatch": "slurm", "address": "ray"}
"""Options that have an effect in one place only."""


@dataclass(kw_only=True)
class LaunchOptions:
    """Train a sweep in parts: on this machine, as a SLURM job array, or on a Ray cluster.

    Options of the sweep follow after `--`, as cgm_jax.sweep has them, but for --config, --from,
    --dry-run, --resume and --shard. In the end the parts are merged in the launch's directory.
    Parts that are killed, preempted or lost with their node are tried again from their last
    checkpoint, for as long as they get further.
    """

    on: Annotated[
        Literal["local", "slurm", "ray"] | None,
        tyro.conf.arg(help_behavior_hint="(default: local)"),
    ] = None
    """Where parts are trained."""

    jobs: int | None = None
    """How many parts; at most as many run at once."""

    out: Path | None = None
    """Directory for everything (default: runs/PRESET-TIME). All machines must have it."""

    resume: Path | None = None
    """Directory of a launch that was stopped: resume it, with other resources if some are given."""

    cores: int | None = None
    """Cores of each part (default: local: an equal share; else 1)."""

    gpus: int | None = None
    """GPUs of each part (default: local: one, where there are any; else none)."""

    memory: float | None = None
    """GiB of memory for each part (default: local: an equal share; else the scheduler's). Locally
    it limits how many parts run at once."""

    minutes: int | None = None
    """slurm: time limit of a job, after which it is requeued (default: 60)."""

    sbatch: tuple[str, ...] = ()
    """slurm: further options of sbatch, such as partition=main account=me."""

    address: str | None = None
    """ray: of the cluster (default: auto, the one of this machine or of RAY_ADDRESS)."""


def check_separated(words: Sequence[str]) -> None:
    """Check that no option of the sweep is among those of the launch.

    Args:
        words: what stands before `--`.

    Raises:
        SettingError: one is.
    """
    of_launch, of_sweep = (
        {item.name for item in fields(kind)} for kind in (LaunchOptions, SweepOptions)
    )
    of_sweep = of_sweep - {"start"} | {"from"}  # as its option is called
    for word in words:
        name = word.partition("=")[0].removeprefix("--").replace("-", "_")
        if word.startswith("--") and name in of_sweep - of_launch:
            raise SettingError(f"{name}: is an option of the sweep; those follow after --")


def planned(options: LaunchOptions, words: Sequence[str]) -> tuple[Launch, list[Group]]:
    """A launch, and the whole sweep.

    Args:
        options: of the launch.
        words: options of the sweep.

    Returns:
        The launch, with the path `Path()` where none was given; and the groups of all runs.

    Raises:
        SettingError: something cannot be as it is asked for.
    """
    _check(options)
    if options.resume is None:
        return _new(options, absolute_words(words))
    return _resumed(options, options.resume, absolute_words(words))


def _check(options: LaunchOptions) -> None:
    """Check what can be checked of the options alone.

    Raises:
        SettingError: one is out of its range or does not go with another.
    """
    if options.resume is not None:
        given = [name for name in ("out", "jobs") if getattr(options, name) is not None]
        if given:
            raise SettingError(f"resume: a launch resumes as it was begun, without {given[0]}")
    elif options.jobs is None:
        raise SettingError("jobs: say how many parts, or --resume DIR")
    elif not 1 <= options.jobs <= MAX_PARTS:
        raise SettingError(f"jobs: {options.jobs} is not within [1, {MAX_PARTS}]")
    for name in ("out", "resume"):
        if getattr(options, name) == Path():
            raise SettingError(f"{name}: is empty")


def _new(options: LaunchOptions, words: Sequence[str]) -> tuple[Launch, list[Group]]:
    """A launch, and the whole sweep.

    Raises:
        SettingError: the sweep is refused, or the directory holds something.
    """
    groups, preset = _groups(words, named_now=True)
    runs = sum(len(group.runs) for group in groups)
    jobs = options.jobs or 1
    if jobs > runs:
        print(f"{jobs} jobs for {runs} runs: there will be {runs}", file=sys.stderr)
    path = Path() if options.out is None else absolute_path(options.out)
    launch = Launch(
        path=path,
        on=options.on or "local",
        parts=min(jobs, runs),
        preset=preset,
        sweep=tuple(words),
        resources=_resources(options, Resources(), options.on or "local"),
    )
    if options.out is not None and is_there("out", path / LAUNCH):
        before = read_launch(path)
        if (before.sweep, before.parts) != (launch.sweep, launch.parts):
            raise SettingError(f"out: {options.out} already holds a launch of another sweep")
    return launch, groups


def _resumed(
    options: LaunchOptions, path: Path, words: Sequence[str]
) -> tuple[Launch, list[Group]]:
    """What was launched in a directory, with the resources that are given now.

    Raises:
        SettingError: nothing was, or it would run code that the user has not named.
    """
    launch = read_launch(path)
    named = parse(SweepOptions, words, f"{PROGRAM} --")
    _check_only_names(words)
    _name_own_code(named)
    recorded = parse(SweepOptions, launch.sweep, f"{PROGRAM} --", from_file=True)
    own = _own_code(recorded)
    for kind, text in _own_code(named):
        if (kind, text) not in own:
            raise SettingError(f"{kind}: {launch.path} was launched with something else")
    if named.track not in (None, recorded.track):
        with_what = recorded.track or "none"
        raise SettingError(f"{TRACK}: {launch.path} was launched with {with_what}")
    for kind, text in own:
        _check_there(kind, text)
        require_named(kind, text)
    groups, _ = _groups(launch.sweep, named_now=False)
    _check_trained(named, groups, launch.path)
    on = options.on or launch.on
    if on not in ENGINES or not 1 <= launch.parts <= sum(len(group.runs) for group in groups):
        raise SettingError(f"{launch.path / LAUNCH} is damaged: {launch.parts} parts on {on!r:.20}")
    resources = _resources(options, launch.resources, on)
    if on == "ray" and resources.address not in (ANY_CLUSTER, options.address):
        # Ray takes code from the cluster that it connects to.
        raise SettingError(
            f"address: {launch.path / LAUNCH} names a Ray cluster; if you trust it, name it: "
            f"--address {shlex.quote(resources.address)}"
        )
    return replace(launch, on=on, resources=resources), groups


def _check_there(kind: str, text: str) -> None:
    """Check that a file of the user's own is where it was, as the parts name it.

    Raises:
        SettingError: it is not.
    """
    place = text.rpartition(":")[0]
    if place.endswith(".py") and not is_there(kind, Path(place)):
        raise SettingError(f"{kind}: {place} is not there any more; a launch resumes with it there")


def _check_only_names(words: Sequence[str]) -> None:
    """Check that options do nothing but name what a launch has, so that its own code may run.

    Raises:
        SettingError: one would change the sweep, or how it is trained.
    """
    for word in words:
        name = word.partition("=")[0].removeprefix("--").replace("-", "_")
        if word.startswith("--") and name not in (*NAMES, TRACK):
            raise SettingError(f"resume: a launch resumes as it was begun, without {name}")


def _check_trained(named: SweepOptions, groups: Sequence[Group], path: Path) -> None:
    """Check that a launch trains with what the user names.

    Raises:
        SettingError: it trains with something else.
    """
    for kind in NAMES:
        trained = {run.values[kind]: None for group in groups for run in group.runs}
        for text in getattr(named, kind) or ():
            if text not in trained:
                there = ", ".join(trained)
                raise SettingError(f"{kind}: {path} was launched with {there}, not {text}")


def _resources(options: LaunchOptions, before: Resources, on: str) -> Resources:
    """Resources of before, but for those that are given.

    Raises:
        SettingError: one is out of its range, or has no effect where parts are trained.
    """
    for name, place in OF_ONE_PLACE.items():
        if getattr(options, name) and on != place:
            raise SettingError(f"{name}: goes with --on {place}")
    names = ("cores", "gpus", "memory", "minutes", "address")
    given = {name: getattr(options, name) for name in names if getattr(options, name) is not None}
    if options.sbatch:
        given["sbatch"] = options.sbatch
    resources = replace(before, **given)
    for name, (low, high) in RANGES.items():
        value = getattr(resources, name)
        if value is not None and not low <= value <= high:
            raise SettingError(f"{name}: {value} is not within [{low}, {high}]")
    return resources


def _groups(words: Sequence[str], *, named_now: bool) -> tuple[list[Group], str]:
    """The whole sweep and its preset; all code of the user's own in it has been loaded.

    Args:
        words: options of the sweep.
        named_now: whether the user gives them now, so that the code in them may run.

    Raises:
        SettingError: the sweep is refused.
    """
    options = parse(SweepOptions, words, f"{PROGRAM} --", from_file=not named_now)
    for name in OWN:
        if getattr(options, name) is not None:
            raise SettingError(f"{name}: goes before --, or is the launch's own")
    for name, option in (("config", "config"), ("start", "from"), ("dry_run", "dry_run")):
        if getattr(options, name):
            raise SettingError(f"{option}: a launch takes its sweep from options alone")
    if named_now:
        _name_own_code(options)
    chosen = seed_values(options, chosen_values(options, named_now=named_now))
    options.resumes()  # checks the rest
    preset = options.preset or options.default_preset
    groups = build_groups(preset, chosen)
    for kind, text in _own_code(options):
        importlib.import_module("cgm_jax.envs.quiet_import")  # ahead of Brax, which it silences
        load_named(kind, text)
    return groups, preset


def _own_code(options: Any) -> list[tuple[str, str]]:
    """What of the user's own a sweep names, with the option that names it."""
    texts = [(kind, text) for kind in NAMES for text in getattr(options, kind) or ()]
    texts += [] if options.track is None else [(TRACK, options.track)]
    return [(kind, text) for kind, text in texts if is_own(text)]


def _name_own_code(options: Any) -> None:
    """What the user names of their own runs, a tracker included."""
    for _, text in _own_code(options):
        name_now(text)
