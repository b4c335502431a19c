"""Weights & Biases, offline unless WANDB_MODE says otherwise.

Offline, each process that trains a run leaves a part of it, `offline-run-*`, where wandb keeps its
files (WANDB_DIR, or ./wandb); `wandb sync` joins the parts of a run, which have one id. Online a
resumed run continues. WANDB_PROJECT, WANDB_ENTITY and the like are heeded.
"""

# The package need not be installed; then this file, its namesake, is taken for it.
# pyright: reportMissingImports=false, reportAttributeAccessIssue=false

import hashlib
import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from cgm_jax.results.trackers.protocol import Tracker


@dataclass
class WeightsAndBiases(Tracker):
    """One run of theirs per run of ours, in a group that is the sweep."""

    PACKAGE = "wandb"

    _runs: dict[str, Any] = field(default_factory=dict)

    def begin(self, run: str, settings: Mapping[str, Any], sent: int) -> None:
        """Open the run by an id that is the same in every process."""
        import wandb

        del sent  # steps only grow: an epoch that comes again is dropped where the parts are joined
        mode = os.environ.get("WANDB_MODE", "offline")
        opened = wandb.init(
            project=os.environ.get("WANDB_PROJECT", "cgm_jax"),
            group=self.sweep,
            name=run,
            id=hashlib.sha256(f"{self.sweep}/{run}".encode()).hexdigest()[:32],
            resume=None if mode == "offline" else "allow",
            mode=mode,
            config=dict(settings),
            reinit="create_new",
            settings=wandb.Settings(console="off", silent=True),
        )
        opened.define_metric("*", step_metric="env_steps")
        self._runs[run] = opened

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
