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
from typing import Any, BinaryIO

from cgm_jax.results.merged_provenance import PROVENANCE, of_all
from cgm_jax.results.parts import Part, policies_of
from cgm_jax.storage.checkpoints import write_manifest_again
from cgm_jax.storage.files import reading, replacing
from cgm_jax.storage.layout import START
from cgm_jax.storage.metrics import Row
from cgm_jax.storage.run_directory import RunDirectory

KEPT = ("command", "started", "resumed", "from", *PROVENANCE)
"""Of a part's config, beside its runs."""


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
        **of_all(parts),
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
    with _opened(path) as source, replacing(to) as file:
        shutil.copyfileobj(source, file)


def _opened(path: Path) -> BinaryIO:
    """A file of a part, to be read; that it cannot be says so."""
    with reading(path):
        return path.open("rb")
