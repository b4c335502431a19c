"""What differs between a sweep that was begun and what is asked for now, in words."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from cgm_jax.config.components import NAMES
from cgm_jax.config.fields import SettingError
from cgm_jax.config.grid import Group, Run, structure
from cgm_jax.config.presets import Grid
from cgm_jax.config.settings import Settings
from cgm_jax.config.spelling import spelled
from cgm_jax.machine.commands import shell_command

MAX_SHOWN = 3
"""Settings that a line names; of the values of each as many."""


def check_same(out: Path, recorded: Sequence[Group], asked: Sequence[Group]) -> None:
    """Check that a directory holds the sweep that is asked for.

    Raises:
        SettingError: it holds another one; the message names settings that differ, with the values
            of both.
    """
    if _merged(recorded) == _merged(asked):
        return
    there, here = _values_of(recorded), _values_of(asked)
    differing = [name for name in {**there, **here} if not _same(there.get(name), here.get(name))]
    if not differing:
        raise SettingError(f"out: {out} already holds a sweep of these values in another order")
    # First components, on which depends what further settings there are.
    differing.sort(key=lambda name: name not in NAMES)
    parts = [
        f"{name} {_shown(there.get(name))}, not {_shown(here.get(name))}" for name in differing
    ]
    more = f"; and {len(parts) - MAX_SHOWN} more" if len(parts) > MAX_SHOWN else ""
    advice = ""
    if differing == ["epochs"] and there["epochs"] < here["epochs"] and len(here["epochs"]) == 1:
        resume = ("--resume", out, "--epochs", str(here["epochs"][0]))
        advice = f"; to train it for longer: {shell_command('cgm_jax.sweep', *resume)}"
    raise SettingError(
        f"out: {out} already holds a sweep with {'; '.join(parts[:MAX_SHOWN])}{more}{advice}"
    )


def check_unchanged(directory: Path, recorded: Sequence[Group], chosen: Grid) -> None:
    """Check that settings which are given with --resume are those of the directory.

    Args:
        directory: that is resumed.
        recorded: what it holds.
        chosen: lists of values by setting; of those of `NAMES`, and of epochs, not checked.

    Raises:
        SettingError: one differs; the message has both values.
    """
    there = _values_of(recorded)
    for name, values in chosen.items():
        if name not in (*NAMES, "epochs") and not _same(there.get(name), values):
            raise SettingError(
                f"{name}: {directory} was begun with {_shown(there.get(name))}, not "
                f"{_shown(values)}; a sweep resumes as it was begun"
            )


def _merged(groups: Sequence[Group]) -> list[Group]:
    """Groups with parts of the same program put together again."""
    merged: dict[tuple[Settings, Any], list[Run]] = {}
    for group in groups:
        program = structure(group.settings, group.runs[0].hyper)
        merged.setdefault(program, []).extend(group.runs)
    return [Group(settings, tuple(runs)) for (settings, _), runs in merged.items()]


def _values_of(groups: Sequence[Group]) -> Mapping[str, list[Any]]:
    """The values that runs have, by setting, in order of first appearance."""
    values: dict[str, dict[str, Any]] = {}
    for run in (run for group in groups for run in group.runs):
        for name, value in run.values.items():
            values.setdefault(name, {}).setdefault(spelled(value), value)
    return {name: list(found.values()) for name, found in values.items()}


def _same(there: Sequence[Any] | None, here: Sequence[Any] | None) -> bool:
    return {*map(spelled, there or [])} == {*map(spelled, here or [])}


def _shown(values: Sequence[Any] | None) -> str:
    if not values:
        return "none"
    more = f" and {len(values) - MAX_SHOWN} more" if len(values) > MAX_SHOWN else ""
    return " ".join(spelled(value) for value in values[:MAX_SHOWN]) + more
