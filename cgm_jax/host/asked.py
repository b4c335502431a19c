"""What sweep and train are asked for: options, over a file of settings, over a preset."""

import dataclasses
from pathlib import Path
from typing import NamedTuple

from cgm_jax.config.components import NAMES, builtin_fields, own_fields
from cgm_jax.config.fields import SettingError
from cgm_jax.config.grid import Group, build_groups, groups_again
from cgm_jax.config.presets import Grid
from cgm_jax.config.settings import LOOP_FIELDS
from cgm_jax.config.shards import Shard, cut, former_digests, parse_shard
from cgm_jax.host.setting_options import given_settings
from cgm_jax.host.settings_file import SettingsFile, read_settings_file, typed
from cgm_jax.host.training_options import TrainingOptions, chosen_values, seed_values
from cgm_jax.storage.config_file import damaged
from cgm_jax.storage.untrusted import UNREADABLE

AGAIN = "config"
"""Recorded as the preset of a sweep whose settings are those of another one's config.json."""


class Asked(NamedTuple):
    """What is asked for.

    Attributes:
        preset: where the settings start from.
        chosen: lists of values that were given, by setting.
        groups: what to train; None to resume a directory.
        start: a file or a directory to start from; None for from scratch.
        start_run: which run of it; None if it has one only.
        shard: which part of a sweep the groups are, if they are one.
        former_shards: the same as earlier versions have recorded it, see `shards.former_digests`.
    """

    preset: str
    chosen: Grid
    groups: list[Group] | None
    start: Path | None = None
    start_run: str | None = None
    shard: Shard | None = None
    former_shards: tuple[Shard, ...] = ()

    @property
    def origin(self) -> str | None:
        """What is started from, in a form that holds in any working directory."""
        if self.start is None:
            return None
        return str(self.start.absolute()) + (f", {self.start_run}" if self.start_run else "")


def asked_for(options: TrainingOptions) -> Asked:
    """What options ask for: a whole sweep, or with --shard a part of it.

    Raises:
        SettingError: they are out of their range or in contradiction, or ask for nothing that
            could be trained.
    """
    text = getattr(options, "shard", None)
    piece = None if text is None else parse_shard(text)
    if piece is not None and options.resume is not None:
        raise SettingError("resume: a sweep resumes as it was begun, without shard")
    asked = _whole(options)
    if piece is None or asked.groups is None:
        return asked
    groups, shard = cut(asked.groups, *piece)
    former = [dataclasses.replace(shard, sweep=one) for one in former_digests(asked.groups)]
    return asked._replace(groups=groups, shard=shard, former_shards=tuple(former))


def _whole(options: TrainingOptions) -> Asked:
    resumes, file = options.resumes(), SettingsFile()
    if options.config is not None:
        file = read_settings_file(options.config)
        file.require_named(but=given_settings(options))
    components = {kind: file.named(kind) for kind in NAMES}
    chosen = seed_values(options, chosen_values(options, components))
    preset = options.preset or file.preset or options.default_preset
    if resumes:
        return Asked(preset, chosen, None)
    if file.runs is None:
        fields = LOOP_FIELDS | builtin_fields() | own_fields({**components, **chosen})
        chosen = {**typed(file.grid, fields), **chosen}
    elif options.preset:
        raise SettingError(f"preset: {options.config} has all settings; leave preset out")
    if not options.sweeps:
        _check_single(chosen)
    if file.runs is None:
        groups = build_groups(preset, chosen, single=not options.sweeps)
        return Asked(preset, chosen, groups, options.start, options.from_run)
    try:
        groups = groups_again(file.runs, chosen)
    except SettingError:
        raise
    except UNREADABLE as error:
        assert options.config is not None  # which has the runs
        raise SettingError(f"config: {damaged(options.config, error)}") from None
    count = sum(len(group.runs) for group in groups)
    if count > 1 and not options.sweeps:
        raise SettingError(
            f"config: {options.config} has {count} runs; cgm_jax.sweep takes several"
        )
    return Asked(AGAIN, chosen, groups, options.start or file.start, options.from_run)


def _check_single(chosen: Grid) -> None:
    """Check that every setting has one value.

    Raises:
        SettingError: one has several.
    """
    for name, values in chosen.items():
        if len(values) > 1:
            raise SettingError(f"{name}: takes one value here; cgm_jax.sweep takes several")
