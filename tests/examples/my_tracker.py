"""A tracker of one's own: `--track tests/examples/my_tracker.py:TextFile`."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cgm_jax.results.trackers.protocol import Tracker


@dataclass
class TextFile(Tracker):
    """One text file per run: a line for its settings, for each epoch, and for each file."""

    def begin(self, run: str, settings: Mapping[str, Any], sent: int) -> int:
        if not sent:
            self._add(run, f"settings {json.dumps(dict(settings))}")
        return sent

    def metrics(self, run: str, epoch: int, values: Mapping[str, float]) -> None:
        self._add(run, f"epoch {epoch} {json.dumps(values)}")

    def files(self, run: str, epoch: int, paths: Mapping[str, Path]) -> None:
        for name in paths:
            self._add(run, f"file {name}")

    def end(self, run: str) -> None:
        self._add(run, "end")

    def _add(self, run: str, line: str) -> None:
        with (self.folder / f"{run}.txt").open("a") as file:
            file.write(line + "\n")
