"""Sends what a sweep records to a tracker: each epoch once, and a failure costs no training.

Rows are sent after they are in metrics.jsonl. What has been sent is kept beside them, so that a
resumed sweep sends the rest, be it new, missed by a tracker that failed, or trained before there
was one. Epochs that are trained again, since the last checkpoint was older, are not sent again.

DIR/tracking/NAME.json  what has been sent;  DIR/tracking/NAME/  the tracker's own
"""

import hashlib
import json
import secrets
import sys
from collections.abc import Callable, Mapping, Sequence
from importlib.util import find_spec
from numbers import Real
from pathlib import Path
from typing import Any, Self

from cgm_jax.config.components import TRACK, check_names, component
from cgm_jax.config.fields import SettingError
from cgm_jax.config.grid import Run
from cgm_jax.config.named import absolute, is_own, label, name_now
from cgm_jax.results.trackers.protocol import Tracker
from cgm_jax.storage.files import replacing
from cgm_jax.storage.metrics import Row
from cgm_jax.storage.untrusted import UNREADABLE, read_json

SWEEP = "sweep"
"""What trackers call the run that shows the figures of all."""

MAX_BYTES = 2**28
"""Of the file that says what has been sent."""


def find_tracker(name: str) -> type[Tracker]:
    """The class that `--track NAME` stands for; the user names it now, so one of their own may run.

    Raises:
        SettingError: there is none, it misspells what it means to override, or the package that it
            needs is not installed.
    """
    if is_own(name):
        name_now(name)
    found = component(TRACK, name)
    check_names(TRACK, name, found)
    if found.PACKAGE and find_spec(found.PACKAGE) is None:
        raise SettingError(
            f"track: {name} needs the package {found.PACKAGE}, which is not installed: "
            "pip install '.[tracking]'"
        )
    return found


class Tracking:
    """A sweep's tracker and what it has been sent; or none, which takes anything and does nothing.

    On leaving the block it is closed.
    """

    def __init__(self, name: str | None = None, directory: Path = Path()) -> None:
        """Continue where an earlier process has ended.

        Args:
            name: of the tracker, None for none.
            directory: of the sweep, which this process has locked.

        Raises:
            SettingError: there is no such tracker, or the record of what was sent is damaged.
            OSError: the directory cannot be written to.
        """
        self.name = None if name is None else absolute(name)
        self._tracker: Tracker | None = None
        self._open: list[str] = []
        self._closed: set[str] = set()
        self._sent: dict[str, int] = {}
        self._runs: dict[str, Mapping[str, Any]] = {}
        if name is None:
            return
        kind, folder = find_tracker(name), directory / "tracking" / label(name)
        self._record = folder.with_name(f"{folder.name}.json")
        folder.mkdir(parents=True, exist_ok=True)
        kept = _read(self._record, directory)
        self._sweep, self._sent, self._closed, self._files = kept
        self._attempt(lambda: setattr(self, "_tracker", kind(folder, self._sweep)))

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.end()

    def begin(self, runs: Sequence[Run], rows: Sequence[Row]) -> None:
        """Open runs, and send those of their rows that the tracker lacks.

        Runs that were closed wait for a row that is new.
        """
        self._runs = {run.name: run.values for run in runs}
        for run in self._runs:
            if run not in self._closed:
                self._begin(run)
        self.send(rows)

    def send(self, rows: Sequence[Row]) -> None:
        """Send rows that are in metrics.jsonl, of runs that `begin` was given."""
        for row in rows:
            if row["epoch"] > self._sent.get(row["run"], 0):
                self._begin(row["run"])
                self._send(row)
        self._keep()

    def _send(self, row: Row) -> None:
        run, epoch = row["run"], row["epoch"]
        if self._tracker is not None and epoch > self._sent.get(run, 0):
            values = scalars(row, {*self._runs[run], "cgm", "epoch"})
            if self._attempt(self._tracker.metrics, run, epoch, values):
                self._sent[run] = epoch

    def show(self, paths: Mapping[str, Path], epoch: int) -> None:
        """Send PNG and GIF files that are new or have changed, as of an epoch."""
        if self._tracker is not None:
            self._attempt(self._show, self._tracker, paths, epoch)
        self._keep()

    def _show(self, tracker: Tracker, paths: Mapping[str, Path], epoch: int) -> None:
        digests = {name: _digest(path) for name, path in paths.items()}
        changed = {n: path for n, path in paths.items() if digests[n] != self._files.get(n)}
        if changed:
            self._open_run(tracker, SWEEP, {})
            tracker.files(SWEEP, epoch, changed)
            self._files |= digests
            self._sent[SWEEP] = epoch

    def end(self) -> None:
        """Close all runs that are open."""
        for run in self._open:
            if self._tracker is not None and self._attempt(self._tracker.end, run):
                self._closed.add(run)
        self._open = []
        self._keep()

    def _begin(self, run: str) -> None:
        if self._tracker is not None and run not in self._open:
            self._attempt(self._open_run, self._tracker, run, self._runs[run])

    def _open_run(self, tracker: Tracker, run: str, settings: Mapping[str, Any]) -> None:
        self._sent[run] = tracker.begin(run, settings, self._sent.get(run, 0))
        self._open.append(run)
        self._closed.discard(run)

    def _keep(self) -> None:
        if self._tracker is not None:
            kept = {
                "sweep": self._sweep,
                "sent": self._sent,
                "closed": sorted(self._closed),
                "files": self._files,
            }
            self._attempt(_write, self._record, kept)

    def _attempt(self, action: Callable[..., object], *arguments: Any) -> bool:
        """Do something that may fail; then say so, and do without the tracker from now on."""
        try:
            action(*arguments)
        except Exception as error:
            line = str(error).partition("\n")[0]
            print(
                f"track: {self.name} failed ({type(error).__name__}: {line}); training continues "
                "without it, and resuming with --track sends what it lacks",
                file=sys.stderr,
            )
            self._tracker = None
            return False
        return True


def scalars(row: Row, settings: set[str]) -> dict[str, float]:
    """The numbers of a row that are no settings, those of lists as `name/position`."""
    found = {}
    for name, value in row.items():
        if name in settings:
            continue
        several = value if isinstance(value, list) else []
        numbered = {name: value} | {f"{name}/{i}": part for i, part in enumerate(several)}
        found |= {key: float(part) for key, part in numbered.items() if isinstance(part, Real)}
    return found


def _read(path: Path, directory: Path) -> tuple[str, dict[str, int], set[str], dict[str, str]]:
    """The sweep's label, the last epoch sent per run, runs that are closed, digests of files."""
    try:
        kept = read_json(path, MAX_BYTES)
        sweep, closed = kept["sweep"], set(kept["closed"])
        sent, files = dict(kept["sent"]), dict(kept["files"])
        whole = all(isinstance(text, str) for text in (sweep, *closed, *sent, *files))
        whole = whole and all(type(epoch) is int for epoch in sent.values())
        if not whole or not 0 < len(sweep) < 300:
            raise ValueError("it holds something else than what was sent")
    except FileNotFoundError:
        return f"{directory.absolute().name}-{secrets.token_hex(4)}", {}, set(), {}
    except (OSError, *UNREADABLE) as error:
        text = str(error).partition("\n")[0]
        raise SettingError(f"track: {path} is damaged: {type(error).__name__}: {text}") from None
    return sweep, sent, closed, files


def _write(path: Path, kept: Mapping[str, Any]) -> None:
    with replacing(path) as file:
        file.write(json.dumps(kept).encode())


def _digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()
