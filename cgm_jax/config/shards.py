"""Parts of a sweep, for as many processes and machines: `--shard I/N`.

A part holds whole runs. Parts are consecutive pieces of the sweep's list of runs and differ by at
most one run in size, so that each has as few programs to compile as can be.
"""

import hashlib
import json
import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from cgm_jax.config.components import DEFAULTS, NAMES
from cgm_jax.config.fields import SettingError
from cgm_jax.config.grid import Group, Values, defaults_of, swept_settings
from cgm_jax.config.named import portable
from cgm_jax.config.spelling import counted

MAX_PARTS = 10_000


@dataclass(frozen=True)
class Shard:
    """Which part of which sweep a run directory holds.

    Attributes:
        part: its number, from 1.
        parts: how many there are.
        sweep: SHA-256 of the names and settings of all runs of the whole sweep, in order; see
            `digest`.
        swept: names of the settings in which those differ.
    """

    part: int
    parts: int
    sweep: str
    swept: tuple[str, ...]


def parse_shard(text: str) -> tuple[int, int]:
    """I and N of "I/N".

    Raises:
        SettingError: it is not of that form, or I is not within 1 and N.
    """
    found = re.fullmatch(r"([0-9]{1,9})/([0-9]{1,9})", text)
    if found is None:
        raise SettingError(f"shard: {text!r} is not I/N, such as 1/4")
    part, parts = int(found[1]), int(found[2])
    if not 1 <= part <= parts <= MAX_PARTS:
        raise SettingError(f"shard: {text} is not I/N with 1 <= I <= N <= {MAX_PARTS}")
    return part, parts


def cut(groups: Sequence[Group], part: int, parts: int) -> tuple[list[Group], Shard]:
    """One part of a sweep.

    Args:
        groups: of the whole sweep.
        part: which, from 1.
        parts: of how many.

    Raises:
        SettingError: there are more parts than runs.
    """
    count = sum(len(group.runs) for group in groups)
    if parts > count:
        raise SettingError(
            f"shard: {parts} parts of {counted(count, 'run')} are too many; give at most {count}"
        )
    shard = Shard(part, parts, digest(groups), tuple(swept_settings(groups)))
    return piece(groups, part, parts), shard


def piece(groups: Sequence[Group], part: int, parts: int) -> list[Group]:
    """The runs of one part, as in `cut`."""
    count = sum(len(group.runs) for group in groups)
    first, end = count * (part - 1) // parts, count * part // parts
    pieces, before = [], 0
    for group in groups:
        runs = group.runs[max(0, first - before) : max(0, end - before)]
        before += len(group.runs)
        if runs:
            pieces.append(Group(group.settings, runs))
    return pieces


def digest(groups: Sequence[Group]) -> str:
    """What tells a whole sweep from others, on whichever machine a part of it is trained.

    Files of the user's own count by their names, not by the folders in which they lie: what they
    hold is compared when parts are merged. Settings at their default do not count, so that a later
    version which has more of them knows the sweep again.
    """
    runs = [run for group in groups for run in group.runs]
    chosen = [tuple((kind, run.values[kind]) for kind in DEFAULTS) for run in runs]
    defaults = {names: defaults_of(dict(names)) for names in dict.fromkeys(chosen)}
    return _hashed(
        [
            [run.name, _portable(_unlike(run.values, defaults[names]))]
            for run, names in zip(runs, chosen, strict=True)
        ]
    )


def former_digests(groups: Sequence[Group]) -> tuple[str, ...]:
    """The same as earlier versions have recorded it; a part that has one is known by it again.

    All settings counted, and before that also the folders of files of the user's own.
    """
    runs = [run for group in groups for run in group.runs]
    return (
        _hashed([[run.name, _portable(run.values)] for run in runs]),
        _hashed([[run.name, run.values] for run in runs]),
    )


def _unlike(values: Values, defaults: Values) -> Values:
    """Values that are no defaults, and names of components in any case."""
    return {
        name: value
        for name, value in values.items()
        if name in NAMES or name not in defaults or value != defaults[name]
    }


def _portable(values: Values) -> Values:
    own = {kind: portable(values[kind]) for kind in NAMES if kind in values}
    return {**values, **own}


def _hashed(runs: Any) -> str:
    return hashlib.sha256(json.dumps(runs, sort_keys=True).encode()).hexdigest()
