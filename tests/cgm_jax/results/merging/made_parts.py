"""Directories as training parts of a sweep would leave them, and the command that merges them."""

import hashlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cgm_jax import merge
from cgm_jax.config.fields import SettingError
from cgm_jax.config.grid import Group, Run, build_groups
from cgm_jax.config.shards import cut
from cgm_jax.storage.arrays import write_arrays
from cgm_jax.storage.checkpoints import write_manifest
from cgm_jax.storage.metrics import Row, to_lines
from cgm_jax.storage.run_directory import RunDirectory
from tests.cgm_jax.results.figures import made

EPOCHS = 2
OPTIONS = {"curriculum": ["cgm", "full"], "kappa": [4.0], "seed": [0, 1, 2], "epochs": [EPOCHS]}


def whole() -> list[Group]:
    """Six runs of two programs."""
    return build_groups("smoke", OPTIONS)


def row(run: Run, epoch: int, **values: Any) -> Row:
    (made_up,) = made.run([0.5], curriculum=run.values["curriculum"])
    return {**made_up, "run": run.name, "epoch": epoch, "physics_warnings": 0, **values}


def train(
    path: Path,
    groups: list[Group],
    part: int,
    parts: int,
    *,
    until: int = EPOCHS,
    start: tuple[str, int] | None = None,
    **values: Any,
) -> Path:
    """Make the directory that training a part up to an epoch would leave.

    `start` is what it began from: what that was called, and what it held.
    """
    pieces, shard = cut(groups, part, parts)
    with RunDirectory.claimed(path, fresh=True) as directory:
        origin = None
        if start is not None:
            origin, number = start
            directory.write_start({"array": np.array(number)})
        directory.config.write(pieces, "smoke", "1 x cpu", shard=shard, origin=origin)
        all_rows = []
        for index, group in enumerate(pieces):
            own = [row(r, e, **values) for e in range(1, until + 1) for r in group.runs]
            checkpoint(path / "checkpoints", index, own, until, directory.config.read_bytes())
            all_rows += own
            for run in group.runs:
                directory.write_policy(run, {"part": np.array(part)})
                directory.write_improvement(run, 1, {"part": np.array(10 + part)})
        directory.replace_metrics(all_rows)
    return path


def checkpoint(folder: Path, index: int, own: list[Row], epoch: int, config: bytes) -> None:
    path = folder / f"group{index}_epoch{epoch:06d}_cycle000000.npz"
    arrays = {
        "position": np.array([epoch, 0]),
        "wall_s": np.array(1.0),
        "rows": np.frombuffer(to_lines(own).encode(), np.uint8),
    }
    with path.open("wb") as file:
        write_arrays(file, arrays.items())
    data = path.read_bytes()
    write_manifest(path, hashlib.sha256(data).hexdigest(), len(data), config)


def run(*words: Any) -> int:
    return merge.main([str(word) for word in words])


def refused(tmp_path: Path, *words: Any) -> str:
    """The line with which merging is refused; nothing may have been made."""
    before = sorted(tmp_path.rglob("*"))
    with pytest.raises(SettingError) as error:
        run(*words)
    assert sorted(tmp_path.rglob("*")) == before
    return str(error.value)
