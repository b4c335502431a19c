"""What a merged sweep was trained with, of what each of its parts says that it was."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from cgm_jax.results.parts import Part
from cgm_jax.storage.provenance import HOSTING

BITS = ("versions", "python", "commit", "device", "flags", "variables", "files", "hosted")
"""Entries on which results depend, machines aside, which are many where there are parts."""

PROVENANCE = (*BITS, "machine")
"""Of these each part keeps its own, since parts may have been trained on several machines."""

Entry = Mapping[str, Any]


def differences(parts: Sequence[Part]) -> list[str]:
    """What, of all that results depend on, was not the same for all parts that depend on it.

    Not every part runs each file of the user's own, or hosts each task.
    """
    return [name for name in BITS if _differs(name, [part.config for part in parts])]


def of_all(parts: Sequence[Part]) -> dict[str, Entry]:
    """What the runs of all parts depend on by name: files, hosted tasks, and variables of these.

    Of what several parts have it is as the first of them had it; so is everything else.
    """
    files, hosted, known = {}, {}, set()
    variables = dict(_entry(parts[0].config, "variables"))
    for part in parts:
        for path, digest in _entry(part.config, "files").items():
            if (Path(path).name, digest) not in known:  # it lay elsewhere for each part
                known.add((Path(path).name, digest))
                files[path] = digest
        hosted = {**_entry(part.config, "hosted"), **hosted}
        of_hosts = _hosting(_entry(part.config, "variables"), is_of=True)
        variables = {**of_hosts, **variables}
    return {"files": files, "hosted": hosted, "variables": variables}


def _entry(config: Mapping[str, Any], name: str) -> Entry:
    entry = config.get(name)
    return entry if isinstance(entry, dict) else {}


def _differs(name: str, configs: Sequence[Mapping[str, Any]]) -> bool:
    entries = [config.get(name) or {} for config in configs]  # earlier versions had none for empty
    if not all(isinstance(entry, dict) for entry in entries):
        return _several(entries)
    if name == "files":
        return _common_differ([_by_name(entry) for entry in entries])
    if name == "hosted":
        return _common_differ([_by_task(entry) for entry in entries])
    if name == "variables":
        hosts = [entry for entry, own in zip(entries, configs, strict=True) if own.get("hosted")]
        others = [_hosting(entry, is_of=False) for entry in entries]
        return _several(others) or _several([_hosting(entry, is_of=True) for entry in hosts])
    return _several(entries)


def _several(values: Sequence[Any]) -> bool:
    return len({json.dumps(value, sort_keys=True) for value in values}) > 1


def _common_differ(entries: Sequence[Entry]) -> bool:
    """Whether something that more than one part has is not the same."""
    keys = {key for entry in entries for key in entry}
    return any(_several([entry[key] for entry in entries if key in entry]) for key in keys)


def _hosting(variables: Entry, *, is_of: bool) -> Entry:
    """The variables that matter to hosted tasks alone, or the others."""
    return {key: text for key, text in variables.items() if key.startswith(HOSTING) is is_of}


def _by_name(files: Entry) -> dict[str, list[str]]:
    """What files of a name hold, wherever they lie."""
    found: dict[str, list[str]] = {}
    for path, digest in sorted(files.items(), key=lambda item: str(item[1])):
        found.setdefault(Path(path).name, []).append(str(digest))
    return found


def _by_task(hosted: Entry) -> dict[str, dict[str, Any]]:
    """Versions of packages, of each task that was hosted."""
    found: dict[str, dict[str, Any]] = {}
    for key, version in hosted.items():
        package, _, task = key.partition(" of ")
        found.setdefault(task, {})[package] = version
    return found
