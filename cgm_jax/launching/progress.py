"""One line about all parts, read from their metrics.jsonl."""

import os
import statistics
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import IO, Self

from rich.live import Live
from rich.text import Text

from cgm_jax.host.progress import SteadyConsole
from cgm_jax.storage.untrusted import UNREADABLE, from_json


class Rows:
    """The rows of a growing metrics.jsonl, each read once.

    Attributes:
        count: rows so far.
        success: of each run in its last epoch, None if that had no valid episode.
    """

    def __init__(self, path: Path) -> None:
        """Read from a file that need not be there yet."""
        self._path = path
        self._forget(0)

    def _forget(self, inode: int) -> None:
        self._inode, self._read, self.count = inode, 0, 0
        self.success: dict[str, float | None] = {}

    def update(self) -> None:
        """Read what is new; all anew if the file is another, as after an attempt has begun."""
        try:
            with self._path.open("rb") as file:
                self._update(file)
        except OSError:
            return

    def _update(self, file: IO[bytes]) -> None:
        status = os.fstat(file.fileno())
        if status.st_ino != self._inode or status.st_size < self._read:
            self._forget(status.st_ino)
        file.seek(self._read)
        for line in file:
            if not line.endswith(b"\n"):
                break
            self._read += len(line)
            try:
                row = from_json(line)
                self.success[row["run"]] = row["success_rate"]
            except UNREADABLE:
                continue
            self.count += 1


class JointProgress:
    """How far all parts are together: redrawn in place on a terminal, elsewhere now and then."""

    FIRST_LINE, LINES = 5.0, 30.0
    """Seconds until the first line, and between lines, where nothing is redrawn."""

    READ_SECONDS = 1.0

    def __init__(self, metrics: Mapping[int, Path], epochs: Mapping[int, int]) -> None:
        """Expect so many rows of each part.

        Args:
            metrics: where each part's metrics.jsonl lies.
            epochs: how many rows it will have: epochs of all its runs.
        """
        console = SteadyConsole()
        self._live = Live(console=console, refresh_per_second=2)
        self._redraws = console.can_redraw
        self._rows = {part: Rows(path) for part, path in metrics.items()}
        self._epochs = dict(epochs)
        self._started = self._read = time.monotonic()
        self._next_line, self._last = self._started + self.FIRST_LINE, ""

    def __enter__(self) -> Self:
        if self._redraws:
            self._live.start(refresh=True)
        return self

    def __exit__(self, *_: object) -> None:
        if self._redraws:
            self._live.stop()

    def show(self, done: Sequence[int], running: int) -> None:
        """So many parts run, and these are done."""
        now = time.monotonic()
        if now < self._read:
            return
        self._read = now + self.READ_SECONDS
        for rows in self._rows.values():
            rows.update()
        line = self.line(done, running)
        if self._redraws:
            seconds = f", {now - self._started:.0f} s"
            self._live.update(Text(line + seconds, no_wrap=True, overflow="ellipsis"))
        elif now >= self._next_line and line != self._last:
            self._next_line, self._last = now + self.LINES, line
            print(f"{line}, {now - self._started:.0f} s", file=sys.stderr, flush=True)

    def line(self, done: Sequence[int], running: int) -> str:
        """What there is to say, without the time."""
        total = sum(self._epochs.values())
        rows = sum(
            epochs if part in done else min(epochs, self._rows[part].count)
            for part, epochs in self._epochs.items()
        )
        text = f"{100 * rows // max(1, total)} % of {total:,} epochs over all runs; "
        text += f"{len(done)} of {len(self._epochs)} parts done, {running} running"
        rates = [rate for rows in self._rows.values() for rate in rows.success.values()]
        valid = [rate for rate in rates if isinstance(rate, int | float)]
        if valid:
            middle, low, high = (
                100 * x for x in (statistics.median(valid), min(valid), max(valid))
            )
            text += f"; success median {middle:.0f} % of {len(rates)} runs"
            text += f" ({low:.0f} % to {high:.0f} %)"
        return text
