"""One run directory from the parts of a sweep, as if it had been trained in one.

The rows of the parts' last checkpoints make metrics.jsonl, and the checkpoints go along, so that
`sweep --resume` takes the merged directory for what it is, a finished sweep. Nothing of the user's
own code runs for that.
"""

import json
import os
import re
import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, BinaryIO

from cgm_jax.results.parts import Part, policies_of
from cgm_jax.storage.checkpoints import write_manifest_again
from cgm_jax.storage.files import reading, replacing
from cgm_jax.storage.layout import START
from cgm_jax.storage.metrics import Row
from cgm_jax.storage.provenance import HOSTING
from cgm_jax.storage.run_directory import RunDirectory

BITS = ("versions", "python", "commit", "device", "flags", "variables", "files", "hosted")
"""Entries on which results depend, machines aside, which are many where there are parts."""

PROVENANCE = (*BITS, "machine")
"""Of these each part keeps its own, since parts may have been trained on several machines."""

OF_RUNS = ("files", "hosted", "variables")
"""Entries that hold, by name, what a part's own runs need."""

KEPT = ("command", "started", "resumed", "from", *PROVENANCE)
"""Of a part's config, beside its runs."""


def differences(parts: Sequence[Part]) -> list[str]:
    """What, of all that results depend on, was not the same for all parts."""
    return [name for name in BITS if _differ(name, [part.config.get(name) for part in parts])]


def _differ(name: str, entries: Sequence[Any]) -> bool:
    """Whether parts differ in an entry of their configs.

    Only one part may have run a file or hosted a task; of these, what several have done counts.
    """
    entries = [entry or {} for entry in entries]  # earlier versions had none for what is empty
    if name not in OF_RUNS or not all(isinstance(entry, dict) for entry in entries):
        return _several(entries)
    if name == "files":
        entries = [_by_name(entry) for entry in entries]
    keys = {key for entry in entries for key in entry}
    return any(
        _several([entry.get(key) for entry in entries if key in entry or not _is_own(name, key)])
        for key in keys
    )


def _several(values: Sequence[Any]) -> bool:
    return len({json.dumps(value, sort_keys=True) for value in values}) > 1


def _is_own(name: str, key: str) -> bool:
    """Whether a key is there only where a part's own runs need it."""
    return name != "variables" or key.startswith(HOSTING)


def _by_name(files: dict[str, Any]) -> dict[str, list[str]]:
    """What files of a name hold, wherever they lie."""
    found: dict[str, list[str]] = {}
    for path, digest in sorted(files.items(), key=lambda item: str(item[1])):
        found.setdefault(Path(path).name, []).append(str(digest))
    return found


def write_merged(
    parts: Sequence[Part], directory: RunDirectory, command: Sequence[str]
) -> list[Row]:
    """Put parts together in a directory that holds no sweep yet; return all rows.

    The config is written last, and before it the manifests, from which it could come back: without
    them a directory holds no sweep, whatever else is there. It names the command that asked for
    this.

    Raises:
        OSError: it cannot be written.
    """
    out = directory.path
    for name in ("policies", "figures", "checkpoints"):  # of a merge that was killed
        shutil.rmtree(out / name, ignore_errors=True)
        (out / name).mkdir(parents=True)
    (out / "policies/improvements").mkdir()
    (out / START).unlink(missing_ok=True)
    if parts[0].start is not None:
        _copy(parts[0].path / START, out / START)
    config = _merged_config(parts, command)
    data = (json.dumps(config, indent=2) + "\n").encode()
    for part in parts:
        for name in policies_of(part):
            _copy(part.path / "policies" / name, out / "policies" / name)
    pieces = [piece for part in parts for piece in part.pieces]
    checkpoints = [
        out / "checkpoints" / re.sub(r"^group[0-9]+", f"group{index}", piece.checkpoint.name)
        for index, piece in enumerate(pieces)
    ]
    for checkpoint, piece in zip(checkpoints, pieces, strict=True):
        _link(piece.checkpoint, checkpoint)
    rows = [row for piece in pieces for row in piece.rows]
    directory.replace_metrics(rows)
    if any(RunDirectory(part.path).has_csv() for part in parts):
        directory.write_csv()
    for checkpoint, piece in zip(checkpoints, pieces, strict=True):
        write_manifest_again(piece.checkpoint, checkpoint, data)
    directory.config.replace(config)
    return rows


def _merged_config(parts: Sequence[Part], command: Sequence[str]) -> dict[str, Any]:
    config = {name: value for name, value in parts[0].config.items() if name != "shard"}
    return {
        **config,
        "command": list(command),
        "started": min(str(part.config.get("started", "")) for part in parts),
        "groups": [group for part in parts for group in part.config["groups"]],
        **{name: entry for name in OF_RUNS if (entry := _of_all(parts, name))},
        "parts": [
            {name: part.config[name] for name in KEPT if name in part.config} for part in parts
        ],
    }


def _of_all(parts: Sequence[Part], name: str) -> dict[str, Any]:
    """What the runs of all parts need; of what several have, as the first part had it."""
    found: dict[str, Any] = {}
    for part in parts:
        entry = part.config.get(name)
        for key, value in entry.items() if isinstance(entry, dict) else ():
            found.setdefault(_place(key, part.names) if name == "files" else key, value)
    return found


def _place(file: str, names: Mapping[str, str]) -> str:
    """Where a file of a part lies in the whole, whose own code lies where the first part's did."""
    for old, new in names.items():
        folder, there = (os.path.dirname(text.rpartition(":")[0]) for text in (old, new))  # noqa: PTH120
        if folder and Path(file).is_relative_to(folder):
            return str(Path(there) / Path(file).relative_to(folder))
    return file


def _link(path: Path, to: Path) -> None:
    """A second name for a file that is never changed in place; a copy on another file system."""
    try:
        os.link(path, to)
    except OSError:
        _copy(path, to)


def _copy(path: Path, to: Path) -> None:
    with _opened(path) as source, replacing(to) as file:
        shutil.copyfileobj(source, file)


def _opened(path: Path) -> BinaryIO:
    """A file of a part, to be read; that it cannot be says so."""
    with reading(path):
        return path.open("rb")
