"""trackio's database on this machine: `trackio show --project cgm_jax`.

It lies where trackio keeps it (TRACKIO_DIR); trackio's own variables, such as TRACKIO_SPACE_ID,
send it elsewhere. A resumed run continues.
"""

# The package need not be installed; then this file, its namesake, is taken for it.
# pyright: reportMissingImports=false, reportAttributeAccessIssue=false

import contextlib
import io
import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from cgm_jax.results.trackers.protocol import Tracker


@dataclass
class Trackio(Tracker):
    """One run of theirs per run of ours, named for the sweep and the run.

    It has one open run per process, and writes in the background. So every epoch opens the run and
    finishes it, which costs milliseconds, and what counts as sent is in the database.
    """

    PACKAGE = "trackio"

    _settings: dict[str, Mapping[str, Any]] = field(default_factory=dict)

    def begin(self, run: str, settings: Mapping[str, Any], sent: int) -> int:
        """Remember the settings, and look up to which epoch the database holds the run."""
        from trackio.sqlite_storage import SQLiteStorage

        self._settings[run] = settings
        del sent
        return SQLiteStorage.get_max_step_for_run(_project(), self._name(run)) or 0

    def metrics(self, run: str, epoch: int, values: Mapping[str, float]) -> None:
        """Add values with the epoch as step."""
        with self._opened(run) as opened:
            opened.log(dict(values), step=epoch)

    def files(self, run: str, epoch: int, paths: Mapping[str, Path]) -> None:
        """Add images, and GIFs as videos."""
        import trackio

        with self._opened(run) as opened:
            shown = {
                name: trackio.Video(path) if path.suffix == ".gif" else trackio.Image(path)
                for name, path in paths.items()
            }
            opened.log(shown, step=epoch)

    def end(self, run: str) -> None:
        """Forget the run, which is finished."""
        del self._settings[run]

    @contextlib.contextmanager
    def _opened(self, run: str) -> Iterator[Any]:
        import trackio

        with contextlib.redirect_stdout(io.StringIO()):
            opened = trackio.init(
                project=_project(),
                name=self._name(run),
                group=self.sweep,
                config=dict(self._settings[run]),
                resume="allow",
                embed=False,
                auto_log_cpu=False,
                auto_log_gpu=False,
            )
            yield opened
            trackio.finish()

    def _name(self, run: str) -> str:
        return f"{self.sweep}/{run}"


def _project() -> str:
    return os.environ.get("TRACKIO_PROJECT", "cgm_jax")
