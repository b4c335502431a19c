"""Weights & Biases, offline unless WANDB_MODE says otherwise.

Offline, each process that trains a run leaves a part of it, `offline-run-*`, below
DIR/tracking/wandb; `wandb sync` joins the parts of a run, which have one id. Online a resumed run
continues. WANDB_PROJECT, WANDB_ENTITY, WANDB_DIR and the like are respected.
"""

# The package need not be installed; then this file, its namesake, is taken for it.
# pyright: reportMissingImports=false, reportAttributeAccessIssue=false

import hashlib
import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from cgm_jax.results.trackers.protocol import Tracker

FILE_HEADER, RECORD_HEADER, BLOCK = 7, 7, 2**15


@dataclass
class WeightsAndBiases(Tracker):
    """One run of theirs per run of ours, in a group that is the sweep."""

    PACKAGE = "wandb"

    _runs: dict[str, Any] = field(default_factory=dict)

    def begin(self, run: str, settings: Mapping[str, Any], sent: int) -> int:
        """Open the run by an id that is the same in every process."""
        import wandb

        mode = os.environ.get("WANDB_MODE", "offline")
        base = Path(os.environ.get("WANDB_DIR", self.folder))
        identifier = hashlib.sha256(f"{self.sweep}/{run}".encode()).hexdigest()[:32]
        # wandb writes in the background, so that a killed process leaves less than it was given.
        parts = list(base.glob(f"wandb/offline-run-*-{identifier}/run-{identifier}.wandb"))
        held = max(map(_last_step, parts), default=0) if mode == "offline" else sent
        opened = wandb.init(
            project=os.environ.get("WANDB_PROJECT", "cgm_jax"),
            group=self.sweep,
            name=run,
            id=identifier,
            resume=None if mode == "offline" else "allow",
            mode=mode,
            dir=str(base),
            config=dict(settings),
            reinit="create_new",
            # Links in a run directory are not followed, and so not made.
            settings=wandb.Settings(console="off", silent=True, symlink=False),
        )
        if settings:
            opened.define_metric("*", step_metric="env_steps")
        self._runs[run] = opened
        return held

    def metrics(self, run: str, epoch: int, values: Mapping[str, float]) -> None:
        """Add values with the epoch as step."""
        self._runs[run].log({"epoch": epoch, **values}, step=epoch, commit=True)

    def files(self, run: str, epoch: int, paths: Mapping[str, Path]) -> None:
        """Add images, and GIFs as videos."""
        import wandb

        shown = {
            name: wandb.Video(str(path)) if path.suffix == ".gif" else wandb.Image(str(path))
            for name, path in paths.items()
        }
        self._runs[run].log(shown, step=epoch, commit=True)

    def end(self, run: str) -> None:
        """Write the rest of the run."""
        self._runs.pop(run).finish()


def _last_step(path: Path) -> int:
    """The last step in the file of an offline run, 0 if there is none."""
    return max((record.history.step.num for record in read_records(path)), default=0)


def read_records(path: Path) -> Iterator[Any]:
    """The records of an offline run's file, less one that was left half written.

    A header of seven bytes, then blocks of 32 KiB as in LevelDB's log: a record has a checksum, its
    length and whether it is whole (1) or the first, a middle or the last part of one (2, 3, 4).
    """
    from wandb.proto.wandb_internal_pb2 import Record

    data, place, parts = path.read_bytes(), FILE_HEADER, b""
    while place + RECORD_HEADER <= len(data):
        left = BLOCK - place % BLOCK
        kind = data[place + 6]
        if left < RECORD_HEADER or not kind:  # the rest of the block is empty
            place += left
            continue
        start = place + RECORD_HEADER
        place = start + int.from_bytes(data[place + 4 : place + 6], "little")
        if place > len(data):
            return
        parts += data[start:place]
        if kind in (1, 4):
            yield Record.FromString(parts)
            parts = b""
