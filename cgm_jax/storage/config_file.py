"""What config.json says of a sweep's runs.

It may come from anybody: whatever is wrong with it is one line, and nothing that it names is run.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from cgm_jax.config.components import NAMES
from cgm_jax.config.fields import SettingError
from cgm_jax.config.grid import Group, run_of, structure
from cgm_jax.config.named import is_own
from cgm_jax.config.run_names import MAX_NAME
from cgm_jax.storage.files import DISK_FAULTS, ReadError
from cgm_jax.storage.formats import upgraded
from cgm_jax.storage.layout import START
from cgm_jax.storage.untrusted import MAX_CONFIG_BYTES, UNREADABLE, read_json


def read_groups(path: Path) -> list[dict[str, dict[str, Any]]]:
    """All values of each run of a config.json, by group and name; nothing that it names runs.

    Raises:
        SettingError: the file cannot be read, or is no config.json.
    """
    try:
        groups = upgraded(read_config(path))["groups"]
        named = [[_named_values(values) for values in group["runs"]] for group in groups]
        names = [name for group in named for name, _ in group]
        if not names or len({*names}) < len(names):
            raise ValueError("it needs runs, each with a name of its own")
        return [dict(group) for group in named]
    except UNREADABLE as error:
        raise damaged(path, error) from None


def start_beside(config: Path) -> Path | None:
    """The arrays that the sweep of a config.json started from; None for from scratch.

    Raises:
        SettingError: they are not beside it, or it cannot be read.
    """
    origin, start = read_origin(config), config.with_name(START)
    if origin is None:
        return None
    if not start.is_file():
        raise SettingError(f"from: {config} began from {origin}, but {start} is missing")
    return start


def read_origin(path: Path) -> str | None:
    """What the sweep of a config.json started from, as it was named; None for from scratch.

    Raises:
        SettingError: the file cannot be read.
    """
    try:
        origin = read_config(path).get("from")
    except UNREADABLE as error:
        raise damaged(path, error) from None
    return None if origin is None else str(origin)


def read_config(path: Path) -> Any:
    """What a config.json holds, unchecked.

    Raises:
        SettingError: it cannot be read, is no ordinary file or too large, or is no JSON.
        ReadError: the disk does not hand it out just now.
    """
    try:
        return read_json(path, MAX_CONFIG_BYTES)
    except (OSError, *UNREADABLE) as error:
        if isinstance(error, OSError) and error.errno in DISK_FAULTS:
            raise ReadError(error.errno, error.strerror or str(error), str(path)) from None
        raise damaged(path, error) from None


class DamagedError(SettingError):
    """A file cannot be used; the line names it."""


def damaged(path: Path, error: Exception) -> SettingError:
    """The line that says why a file cannot be used; one that was said already stays as it is."""
    if isinstance(error, DamagedError):
        return error
    kind = "" if isinstance(error, SettingError) else f"{type(error).__name__}: "
    text = str(error).partition("\n")[0]
    return DamagedError(f"{path} is damaged: {kind}{text}")


def _named_values(entry: Any) -> tuple[str, dict[str, Any]]:
    """A run's name and values from its entry in the config; whatever is wrong with it raises."""
    values = dict(entry)
    name = values.pop("name")
    check_name(name)
    for kind in NAMES:
        if not isinstance(values.get(kind, ""), str):
            raise SettingError(f"{kind}: {values[kind]!r:.40} is not of type str")
    for key, value in values.items():
        if isinstance(value, list):  # JSON knows no tuples
            values[key] = tuple(value)
    return name, values


def group_of(entry: Any) -> Group:
    """A group of runs from its entry in the config; whatever is wrong with it raises."""
    pairs = [run_of(*_named_values(values)) for values in entry["runs"]]
    settings = {structure(static, run.hyper): static for static, run in pairs}
    ((_, static),) = settings.items()  # runs of one group share a program
    return Group(static, tuple(run for _, run in pairs))


def recorded_names(config: Any, kind: str) -> list[str]:
    """What a config's runs have as their environment, or as another setting that is a name."""
    runs = [run for group in config["groups"] for run in group["runs"] if kind in run]
    return list(dict.fromkeys(run[kind] for run in runs if isinstance(run[kind], str)))


def renamed(values: Any, names: Mapping[str, str]) -> Any:
    """A config, or a part of it, with other names for own code."""
    if isinstance(values, str):
        return names.get(values, values)
    if isinstance(values, dict):
        return {key: renamed(value, names) for key, value in values.items()}
    return [renamed(value, names) for value in values] if isinstance(values, list) else values


def own_names(groups: Sequence[Group]) -> list[str]:
    """The code of the user's own that groups of runs name, as they name it."""
    names = [run.values.get(kind) for group in groups for run in group.runs for kind in NAMES]
    return list(dict.fromkeys(name for name in names if name and is_own(name)))


def attribute_of(text: str) -> str:
    """NAME of FILE.py:NAME."""
    return text.rpartition(":")[2]


def check_name(name: Any) -> None:
    """Check that a run's name is one of a file, in whichever directory it is put.

    Raises:
        ValueError: it is not.
    """
    valid = isinstance(name, str) and name.isprintable() and not {*"/\\"} & {*name}
    if not valid or not 0 < len(name.encode()) <= MAX_NAME:
        raise SettingError(f"run: {str(name)[:60]!r} is no name for a file")
