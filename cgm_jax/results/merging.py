"""One run directory from the parts of a sweep, as if it had been trained in one.

The rows of the parts' last checkpoints make metrics.jsonl, and the checkpoints go along, so that
`sweep --resume` takes the merged directory for what it is, a finished sweep. Nothing of the user's
own code runs for that.
"""

import json
import os
import re
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from cgm_jax.results.parts import Part, policies_of
from cgm_jax.storage.checkpoints import manifest_path, write_manifest
from cgm_jax.storage.files import replacing
from cgm_jax.storage.layout import START
from cgm_jax.storage.metrics import Row
from cgm_jax.storage.run_directory import RunDirectory

BITS = ("versions", "python", "commit", "device", "flags", "variables", "files", "hosted")
"""Entries on which results depend, machines aside, which are many where there are parts."""

PROVENANCE = (*BITS, "machine")
"""Of these each part keeps its own, since parts may have been trained on several machines."""

KEPT = ("command", "started", "resumed", "from", *PROVENANCE)
"""Of a part's config, beside its runs."""


def differences(parts: Sequence[Part]) -> list[str]:
    """What, of all that results depend on, was not the same for all parts."""
    return [
        name
        for name in BITS
        if len({json.dumps(_compared(part, name), sort_keys=True) for part in parts}) > 1
    ]


def _compared(part: Part, name: str) -> Any:
    """An entry of a part's config; of files, wherever they lie, what they are called and hold."""
    entry = part.config.get(name) or None  # earlier versions had no entry for what is empty
    if name != "files" or not isinstance(entry, dict):
        return entry
    return sorted([Path(path).name, str(digest)] for path, digest in entry.items())


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
    for checkpoint, piece in zip(checkpoints, pieces, strict=True):
        manifest = json.loads(manifest_path(piece.checkpoint).read_bytes())
        write_manifest(checkpoint, manifest["sha256"], manifest["bytes"], data)
    directory.config.replace(config)
    if any(RunDirectory(part.path).has_csv() for part in parts):
        directory.write_csv()
    return rows


def _merged_config(parts: Sequence[Part], command: Sequence[str]) -> dict[str, Any]:
    config = {name: value for name, value in parts[0].config.items() if name != "shard"}
    return {
        **config,
        "command": list(command),
        "started": min(str(part.config.get("started", "")) for part in parts),
        "groups": [group for part in parts for group in part.config["groups"]],
        "parts": [
            {name: part.config[name] for name in KEPT if name in part.config} for part in parts
        ],
    }


def _link(path: Path, to: Path) -> None:
    """A second name for a file that is never changed in place; a copy on another file system."""
    try:
        os.link(path, to)
    except OSError:
        _copy(path, to)


def _copy(path: Path, to: Path) -> None:
    with path.open("rb") as source, replacing(to) as file:
        shutil.copyfileobj(source, file)
