"""What can be chosen by name: curricula, agents, ways to relabel, and trackers; ours or one's own.

A component is one file that declares one class of settings (see fields.py) with the functions
of its protocol; the file's name is the option's value. FILE.py:NAME is a class of the user's own.
A tracker is found in the same way, but has no settings, and changes no result.
"""

import dataclasses
import functools
import importlib
import inspect
import pkgutil
from collections.abc import Mapping, Sequence
from typing import Any

from cgm_jax.config.fields import Field, SettingError, declared
from cgm_jax.config.named import is_own, load_named

ROOMS = {
    "curriculum": "cgm_jax.curricula",
    "agent": "cgm_jax.agents",
    "relabelling": "cgm_jax.replay",
}
"""Where the components of each kind are; `protocol.py` there says what they offer."""

DEFAULTS = {"curriculum": "cgm", "agent": "ddpg", "relabelling": "future"}
"""Names of the components of a run that names none."""

TRACK = "track"
PLACES = {**ROOMS, TRACK: "cgm_jax.results.trackers"}
"""Where the classes of each kind are, one a file, trackers included."""

NAMES = ("env", *ROOMS)
"""Settings whose value is a name, of ours or of something of the user's own."""


@functools.cache
def builtin(kind: str) -> dict[str, type]:
    """The classes that come with this package, by name."""
    room, protocol = importlib.import_module(PLACES[kind]), _protocol(kind)
    found = {}
    for module in pkgutil.iter_modules(room.__path__):
        members = vars(importlib.import_module(f"{room.__name__}.{module.name}"))
        for member in members.values():
            ours = inspect.isclass(member) and member.__module__ == f"{room.__name__}.{module.name}"
            if ours and protocol in member.__mro__[1:] and dataclasses.is_dataclass(member):
                found[module.name] = member
    return found


def component(kind: str, name: str) -> type:
    """The class that `--KIND name` stands for.

    Raises:
        SettingError: there is none, or a file's class does not declare settings.
    """
    if not isinstance(name, str):
        raise SettingError(f"{kind}: {name!r} is not a name")
    if not is_own(name):
        if name not in builtin(kind):
            choices = ", ".join([*sorted(builtin(kind)), "or FILE.py:NAME of your own"])
            raise SettingError(f"{kind}: unknown {kind} {name!r}; choose from {choices}")
        return builtin(kind)[name]
    found = load_named(kind, name)
    if kind in ROOMS and not (inspect.isclass(found) and dataclasses.is_dataclass(found)):
        raise SettingError(f"{kind}: {name} is not a class made by @settings")
    protocol = _protocol(kind)
    if not inspect.isclass(found) or protocol not in found.__mro__:
        raise SettingError(f"{kind}: {name} is not derived from {protocol.__name__}")
    return found


def _protocol(kind: str) -> type:
    return importlib.import_module(f"{PLACES[kind]}.protocol").PROTOCOL


@functools.cache
def builtin_fields() -> dict[str, "Field[Any]"]:
    """Every setting of the components that come with this package, by name.

    Components share an option where they share a setting's name.
    """
    return {
        item.name: item
        for kind in ROOMS
        for found in builtin(kind).values()
        for item in declared(found)
    }


def own_fields(chosen: Mapping[str, Sequence[str]]) -> dict[str, "Field[Any]"]:
    """Every setting of the components of the user's own among those chosen, by name.

    Args:
        chosen: names by kind; other entries are not read.

    Raises:
        SettingError: as `component`.
    """
    return {
        item.name: item
        for kind in ROOMS
        for name in chosen.get(kind, ())
        if is_own(name)
        for item in declared(component(kind, name))
    }


@functools.cache
def owners() -> dict[str, list[tuple[str, str]]]:
    """Which of our components have each setting of theirs: kinds and names, by the setting."""
    found: dict[str, list[tuple[str, str]]] = {}
    for kind in ROOMS:
        for name, one in sorted(builtin(kind).items()):
            for item in declared(one):
                found.setdefault(item.name, []).append((kind, name))
    return found
