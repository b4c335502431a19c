"""Event files for TensorBoard: `tensorboard --logdir DIR/tracking/tensorboard`.

A resumed run adds a file to its folder, which begins by taking back whatever the files before hold
of epochs that come again. TensorBoard plays GIFs among its images.
"""

# The package need not be installed; then this file, its namesake, is taken for it.
# pyright: reportMissingImports=false, reportAttributeAccessIssue=false

import json
import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from PIL import Image

from cgm_jax.results.trackers.protocol import Tracker


@dataclass
class TensorBoard(Tracker):
    """One folder of event files per run."""

    PACKAGE = "tensorboardX"

    _writers: dict[str, Any] = field(default_factory=dict)

    def begin(self, run: str, settings: Mapping[str, Any], sent: int) -> None:
        """Start a file, and show the settings in a new run."""
        from tensorboardX import SummaryWriter

        writer = SummaryWriter(
            str(self.folder / run),
            purge_step=sent + 1 if sent else None,
            # The name tells time in seconds, in which two processes can start.
            filename_suffix=f".{os.getpid()}",
        )
        self._writers[run] = writer
        if not sent:
            text = json.dumps(dict(settings), indent=4)
            writer.add_text("settings", "".join(f"    {line}\n" for line in text.split("\n")))
        writer.flush()

    def metrics(self, run: str, epoch: int, values: Mapping[str, float]) -> None:
        """Add scalars with the epoch as step."""
        writer = self._writers[run]
        for name, value in values.items():
            writer.add_scalar(name, value, epoch)
        writer.flush()

    def files(self, run: str, epoch: int, paths: Mapping[str, Path]) -> None:
        """Add images as they are encoded."""
        from tensorboardX.proto.summary_pb2 import Summary

        for name, path in paths.items():
            with Image.open(path) as image:
                width, height = image.size
            shown = Summary.Image(
                width=width, height=height, colorspace=3, encoded_image_string=path.read_bytes()
            )
            value = Summary.Value(tag=name, image=shown)
            self._writers[run].file_writer.add_summary(Summary(value=[value]), epoch)
        self._writers[run].flush()

    def end(self, run: str) -> None:
        """Close the run's file."""
        self._writers.pop(run).close()
