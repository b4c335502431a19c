"""Event files for TensorBoard: `tensorboard --logdir DIR/tracking/tensorboard`.

A resumed run adds a file to its folder, which begins by taking back whatever the files before hold
of epochs that come again. TensorBoard plays GIFs among its images.
"""

# The package need not be installed; then this file, its namesake, is taken for it.
# pyright: reportMissingImports=false, reportAttributeAccessIssue=false

import json
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from PIL import Image

from cgm_jax.results.trackers.protocol import Tracker


@dataclass
class TensorBoard(Tracker):
    """One folder of event files per run.

    The writer is TensorBoard's own: when its `flush` returns, events are in the file, where
    tensorboardX may lose them if the process is killed.
    """

    PACKAGE = "tensorboard"

    _writers: dict[str, Any] = field(default_factory=dict)

    def begin(self, run: str, settings: Mapping[str, Any], sent: int) -> int:
        """Start a file, and show the settings in a new run."""
        from tensorboard.compat.proto.event_pb2 import SessionLog
        from tensorboard.plugins.text.summary_v2 import text_pb
        from tensorboard.summary.writer.event_file_writer import EventFileWriter

        self._writers[run] = EventFileWriter(str(self.folder / run))
        if sent:  # epochs from here on come again
            self._add(run, sent + 1, session_log=SessionLog(status=SessionLog.START))
        elif settings:
            text = json.dumps(dict(settings), indent=4).replace("\n", "\n    ")
            self._add(run, 0, summary=text_pb("settings", f"    {text}"))
        self._writers[run].flush()
        return sent

    def metrics(self, run: str, epoch: int, values: Mapping[str, float]) -> None:
        """Add scalars with the epoch as step."""
        from tensorboard.compat.proto.summary_pb2 import Summary

        shown = [Summary.Value(tag=name, simple_value=value) for name, value in values.items()]
        self._add(run, epoch, summary=Summary(value=shown))
        self._writers[run].flush()

    def files(self, run: str, epoch: int, paths: Mapping[str, Path]) -> None:
        """Add images as they are encoded."""
        from tensorboard.compat.proto.summary_pb2 import Summary

        for name, path in paths.items():
            with Image.open(path) as image:
                width, height = image.size
            shown = Summary.Image(
                width=width, height=height, colorspace=3, encoded_image_string=path.read_bytes()
            )
            self._add(run, epoch, summary=Summary(value=[Summary.Value(tag=name, image=shown)]))
        self._writers[run].flush()

    def end(self, run: str) -> None:
        """Close the run's file."""
        self._writers.pop(run).close()

    def _add(self, run: str, step: int, **content: Any) -> None:
        from tensorboard.compat.proto.event_pb2 import Event

        self._writers[run].add_event(Event(wall_time=time.time(), step=step, **content))
