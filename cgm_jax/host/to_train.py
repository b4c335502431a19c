"""What is to be trained: found out before anything is made, and recorded before it trains."""

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from cgm_jax.config.components import NAMES
from cgm_jax.config.fields import SettingError
from cgm_jax.config.grid import Group
from cgm_jax.config.shards import Shard
from cgm_jax.host.asked import Asked
from cgm_jax.host.devices import check_devices, cpu_devices, describe_devices, parse_devices
from cgm_jax.host.differences import check_same, check_unchanged
from cgm_jax.host.extension import extended
from cgm_jax.host.startup import prepare_jax
from cgm_jax.host.training_options import TrainingOptions
from cgm_jax.machine.allotment import share_cores
from cgm_jax.storage.config_file import read_origin
from cgm_jax.storage.layout import CONFIG
from cgm_jax.storage.run_directory import RunDirectory

if TYPE_CHECKING:  # jobs imports JAX
    from cgm_jax.host.jobs import Job


class ToTrain(NamedTuple):
    """What is to be trained.

    Attributes:
        jobs: all of it, built but not compiled.
        notes: on how, for the user.
        recorded: the groups of the sweep that the directory already holds; None if it is new.
        moved: own code that has been named again, see `SweepConfig.moved`.
        start: what a new sweep starts from; None for from scratch.
    """

    jobs: "list[Job]"
    notes: list[str]
    recorded: list[Group] | None
    moved: Mapping[str, str]
    start: dict[str, np.ndarray] | None


def find_to_train(options: TrainingOptions, asked: Asked, out: Path | None) -> ToTrain:
    """Find out what is to be trained; nothing is made yet.

    Raises:
        SettingError: something cannot be as it is asked for.
        ReadError: a file cannot be read just now.
    """
    moved = {}
    if asked.groups is None and out is not None:
        # What own code the user names goes with what the directory holds.
        named = {kind: asked.chosen.get(kind, ()) for kind in NAMES}
        moved = RunDirectory.open(out).config.moved(named)
    recorded = None if out is None else _recorded_groups(out, asked, moved)
    groups, devices = recorded or asked.groups or [], parse_devices(options.devices)
    jobs, notes = plan(groups, devices, planned=recorded is not None)
    return ToTrain(jobs, notes, recorded, moved, None if recorded else _start(asked, jobs))


def record(
    directory: RunDirectory, to_train: ToTrain, asked: Asked, command: Sequence[str]
) -> list[str]:
    """Record what is about to be trained in its directory; return what there is to say of it.

    Raises:
        SettingError, ReadError: see `_notes_on_resuming`.
        OSError: it cannot be written.
    """
    jobs, device = to_train.jobs, describe_devices()
    if to_train.recorded is not None:
        notes = _notes_on_resuming(directory, jobs, device, to_train.recorded, to_train.moved)
        _record_shard(directory, asked.shard)
        return notes
    if to_train.start is not None:
        directory.write_start(to_train.start)
    groups = [job.group for job in jobs]
    directory.config.write(groups, asked.preset, device, asked.shard, asked.origin, command)
    return []


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
    on_cpu = jax.default_backend() == "cpu"
    found = jax.devices()[: sharing if on_cpu else devices]
    if on_cpu:
        share_cores(len(found))  # fewer than asked for, where JAX has started with fewer
    return plan_jobs(groups, found, planned=planned)


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
    if shard != asked.shard and shard not in asked.former_shards:
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
    from cgm_jax.host.beginning import check_last_checkpoints, check_starts

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
