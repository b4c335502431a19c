"""What can be chosen by name: curricula, agents, ways to relabel, and trackers; ours or one's own.

A component is one file that declares one class of settings (see fields.py) with the functions
of its protocol; the file's name is the option's value. FILE.py:NAME is a class of the user's own.
A tracker is found in the same way, but has no settings, and changes no result.
"""

import dataclasses
import difflib
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

OURS = "cgm_jax."

CLOSE = 0.88
"""Names that are as like as this, by `difflib`, may be meant to be the same."""


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
        SettingError: there is none, or a file's class does not declare settings, or lacks what its
            protocol leaves to it.
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
    if kind in ROOMS and (missing := _missing(found, protocol)):
        place = f"{protocol.__module__}.{protocol.__name__}"
        raise SettingError(f"{kind}: {name} lacks {', '.join(missing)}; see {place}")
    return found


def _missing(found: type, protocol: type) -> list[str]:
    """Names that a protocol leaves to its classes, and that a class does not define."""
    values = [name for name in protocol.__annotations__ if not hasattr(found, name)]
    return [*values, *sorted(found.__abstractmethods__)]  # pyright: ignore[reportAttributeAccessIssue]


def check_names(kind: str, name: str, found: type) -> None:
    """Check that a class does not misspell what it means to override, which would have no effect.

    Args:
        kind: of the component.
        name: of the class, for messages.
        found: the class.

    Raises:
        SettingError: it has a public name that is nearly one of the protocol's, and leaves that
            one as it is.
    """
    protocol = _protocol(kind)
    # What a class of ours defines is, for one derived from it, as good as the protocol's.
    bases = [one for one in found.__mro__ if one is found or not one.__module__.startswith(OURS)]
    own = {each for base in bases for each in vars(base) if not each.startswith("_")}
    offered = [each for each in vars(protocol) if not each.startswith("_")]
    inherited = [each for each in offered if each not in own]
    for each in sorted(own - {*offered, *(item.name for item in declared(found))}):
        is_function = callable(getattr(found, each))
        alike = [one for one in inherited if callable(getattr(protocol, one)) == is_function]
        for meant in difflib.get_close_matches(each, alike, 1, CLOSE):
            raise SettingError(
                f"{kind}: {name} has {each}, which training does not know; write {meant}, or "
                f"_{each} for something of your own"
            )


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
