"""What a sweep writes, and where.

DIR/config.json           everything needed to run it again, versions included
DIR/metrics.jsonl         one object per run and epoch; metrics.csv the same as a table
DIR/start.npz             what a sweep with --from starts from
DIR/policies/<run>.npz    the deterministic actor; improvements/ has each that was the best so far
DIR/figures/*.png         and best_policy.gif, where a tracker is to have it
DIR/tracking/             what a tracker was sent, and what it keeps here (results/tracking.py)
DIR/checkpoints/          the whole training state of each group, see checkpoint.py
DIR/lock, DIR/holder      held while a sweep writes here, and by whom
DIR/launch.json           what was launched in parts, of which parts/, attempts/ and logs/ are, and
                          slurm/, in which each launcher has a folder for its jobs

A directory may come from anybody. Nothing in it leads out of it, neither a name in its config nor a
symbolic link; and code that its config names runs only if the user has named it (config/named.py).
"""

import contextlib
import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from cgm_jax.config.fields import SettingError
from cgm_jax.config.grid import Run
from cgm_jax.storage.arrays import write_arrays
from cgm_jax.storage.checkpoints import epochs_begun
from cgm_jax.storage.config_file import damaged
from cgm_jax.storage.files import DISK_FAULTS, reading, remove_partials, replacing
from cgm_jax.storage.layout import (
    CONFIG,
    LAUNCH,
    METRICS,
    START,
    TABLE,
    check_parts,
    why_it_holds_none,
)
from cgm_jax.storage.lock import locked
from cgm_jax.storage.metrics import Row, check_row, to_csv, to_lines
from cgm_jax.storage.sweep_config import SweepConfig
from cgm_jax.storage.untrusted import UNREADABLE, from_json

FOLDERS = ("policies", "policies/improvements", "figures", "checkpoints", "tracking")
FILES = (CONFIG, START, METRICS, TABLE, LAUNCH)


@contextlib.contextmanager
def claiming(path: Path, *, fresh: bool = True) -> Iterator[None]:
    """Tell a directory that was badly chosen from a disk that fails, which is nobody's input.

    Args:
        path: the directory that the block makes, or writes to.
        fresh: whether it was chosen just now, and did not serve before.

    Raises:
        SettingError: it cannot be written to, as for want of rights.
        OSError: the disk fails, or the directory served before.
    """
    try:
        yield
    except OSError as error:
        if not fresh or error.errno in DISK_FAULTS:
            raise
        raise SettingError(f"out: cannot write to {path}: {error.strerror}") from None


@dataclass(frozen=True)
class RunDirectory:
    """The directory of one sweep."""

    path: Path

    @classmethod
    @contextlib.contextmanager
    def claimed(cls, path: Path, *, fresh: bool) -> Iterator["RunDirectory"]:
        """Make a directory, or take one up again, and lock it while the block runs.

        Args:
            path: the directory.
            fresh: whether it must not hold a sweep or a launch yet.

        Raises:
            SettingError: it is fresh and cannot be written to, it is not fresh but is to be, or a
                part of it leads elsewhere.
            OSError: the disk fails, or it is not fresh and cannot be written to.
            InUseError: another process has it.
        """
        check_parts(path)
        directory = cls(path)
        if fresh:
            directory.check_fresh()
        with contextlib.ExitStack() as stack:
            with claiming(path, fresh=fresh):
                for part in ("policies/improvements", "figures", "checkpoints"):
                    (path / part).mkdir(parents=True, exist_ok=True)
                stack.enter_context(locked(path))
            if fresh:  # also of a process that had the lock until now
                directory.check_fresh()
            directory.remove_partials()
            yield directory

    @classmethod
    def open(cls, path: Path) -> "RunDirectory":
        """A directory that a sweep has written.

        Raises:
            SettingError: it holds none, or a part of it leads elsewhere.
        """
        if not cls(path).holds_sweep():
            raise SettingError(why_it_holds_none(path, CONFIG))
        check_parts(path)
        return cls(path)

    def holds_sweep(self) -> bool:
        """Whether a sweep has been begun here."""
        try:
            return (self.path / CONFIG).is_file()
        except OSError:  # such as a name that is too long
            return False

    def check_fresh(self, also: Sequence[str] = ()) -> None:
        """Check that no sweep has been begun here, whatever is left of it, and no launch.

        Nor may there be a file where a sweep writes, whoever has made it; but for start.npz, which
        is written before the config and so may be left of a sweep that was not begun.

        Args:
            also: further folders where no file may be.

        Raises:
            SettingError: one has, or there is.
        """
        try:
            held = [name for name in (CONFIG, METRICS, LAUNCH) if (self.path / name).exists()]
            places = [self.path / name for name in (TABLE, *FOLDERS, *also)]
            files = itertools.chain(places, *(place.rglob("*") for place in places))
            found = next((file for file in files if file.is_file()), None)
        except OSError:  # such as a name that is too long, as making the directory will say
            return
        if held:
            what = "a launch" if held == [LAUNCH] else "a sweep"
            raise SettingError(f"out: {self.path} already holds {what}; name another directory")
        if found is not None:
            raise SettingError(f"out: {found} lies where a sweep writes; name another directory")

    def remove_partials(self) -> None:
        """Remove what killed processes have left half written; whoever has the lock may."""
        for folder in FOLDERS:
            remove_partials(self.path / folder)
        for name in FILES:  # not of a page, which is written without the lock
            remove_partials(self.path, name)

    @property
    def config(self) -> SweepConfig:
        """What was asked for, and what has changed since."""
        return SweepConfig(self.path)

    def append_metrics(self, rows: Sequence[Row]) -> None:
        """Add rows to metrics.jsonl.

        Raises:
            OSError: they cannot be written.
        """
        with (self.path / METRICS).open("a", encoding="utf-8") as file:
            file.write(to_lines(rows))

    def replace_metrics(self, rows: Sequence[Row]) -> None:
        """Make these the only rows of metrics.jsonl.

        Raises:
            OSError: they cannot be written.
        """
        with replacing(self.path / METRICS, durable=True) as file:
            file.write(to_lines(rows).encode())

    def count_metrics(self) -> int | None:
        """How many lines metrics.jsonl has, whole or torn; None if it is not there.

        Raises:
            ReadError: it is there, but cannot be read.
        """
        path = self.path / METRICS
        with reading(path):
            return len(path.read_bytes().splitlines()) if path.exists() else None

    def set_metrics_aside(self) -> Path:
        """Give metrics.jsonl another name, metrics.jsonl.1 or the next that is free; return it.

        Raises:
            OSError: it cannot be renamed.
        """
        path = self.path / METRICS
        names = (path.with_name(f"{METRICS}.{number}") for number in itertools.count(1))
        aside = next(name for name in names if not name.exists())
        path.replace(aside)
        return aside

    def metrics(self) -> list[Row]:
        """All rows of metrics.jsonl, less one that a killed process left half written."""
        with (self.path / METRICS).open(encoding="utf-8") as file:
            return [from_json(line) for line in file if line.endswith("\n")]

    def former_metrics(self) -> dict[str, list[Row]]:
        """What can be read of metrics.jsonl, by run, each epoch once; nothing if it is not there.

        Raises:
            ReadError: the file is there, but cannot be read.
        """
        path, found = self.path / METRICS, dict[tuple[str, int], Row]()
        with reading(path):
            lines = path.read_bytes().splitlines() if path.exists() else []
        for line in lines:
            with contextlib.suppress(*UNREADABLE):
                row = from_json(line)
                check_row(row)
                found[row["run"], row["epoch"]] = row
        rows: dict[str, list[Row]] = {}
        for (run, _), row in found.items():
            rows.setdefault(run, []).append(row)
        return rows

    def checked_metrics(self) -> list[Row]:
        """The same, of a directory that may come from anybody.

        Raises:
            SettingError: they cannot be read, or are not such as a sweep writes.
        """
        try:
            rows = self.metrics()
            for row in rows:
                check_row(row)
            if not rows:
                raise ValueError("it has no row")
        except (OSError, *UNREADABLE) as error:
            raise damaged(self.path / METRICS, error) from None
        return rows

    def has_csv(self) -> bool:
        """Whether metrics.csv has been asked for before."""
        return (self.path / TABLE).exists()

    def write_csv(self) -> None:
        """Write the rows of metrics.jsonl as a table, metrics.csv.

        Raises:
            OSError: it cannot be written.
        """
        with replacing(self.path / TABLE) as file:
            file.write(to_csv(self.metrics()).encode())

    def epochs_begun(self) -> int:
        """Epochs of the run that has come farthest, by checkpoints and by metrics."""
        try:
            written = [row["epoch"] for rows in self.former_metrics().values() for row in rows]
        except OSError:  # checkpoints will restore them
            written = []
        return max([epochs_begun(self.path / "checkpoints"), *written])

    def policy_path(self, run: Run) -> Path:
        """Where a run's policy lies."""
        return self.path / "policies" / f"{run.name}.npz"

    def write_start(self, arrays: Mapping[str, np.ndarray]) -> None:
        """Keep what the sweep starts from, so that it depends on no other directory.

        Raises:
            OSError: it cannot be written.
        """
        _write_npz(self.path / START, arrays)

    def write_policy(self, run: Run, arrays: Mapping[str, np.ndarray]) -> None:
        """Write or replace a run's policy; a reader never sees half a file.

        Raises:
            OSError: it cannot be written.
        """
        _write_npz(self.policy_path(run), arrays)

    def write_improvement(self, run: Run, epoch: int, arrays: Mapping[str, np.ndarray]) -> None:
        """Keep the policy with which a run became better than ever.

        Raises:
            OSError: it cannot be written.
        """
        _write_npz(self.path / "policies/improvements" / f"{run.name}_epoch{epoch}.npz", arrays)


def _write_npz(path: Path, arrays: Mapping[str, np.ndarray]) -> None:
    with replacing(path) as file:
        write_arrays(file, arrays.items())
