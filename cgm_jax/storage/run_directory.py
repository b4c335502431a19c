"""What a sweep writes, and where.

DIR/config.json           everything needed to run it again, versions included
DIR/metrics.jsonl         one object per run and epoch; metrics.csv the same as a table
DIR/start.npz             what a sweep with --from starts from
DIR/policies/<run>.npz    the deterministic actor; improvements/ has each that was the best so far
DIR/figures/*.png         and best_policy.gif, where a tracker is to have it
DIR/tracking/             what a tracker was sent, and what it keeps here (results/tracking.py)
DIR/checkpoints/          the whole training state of each group, see checkpoint.py
DIR/lock, DIR/holder      held while a sweep writes here, and by whom
DIR/launch.json           what was launched in parts, of which parts/, attempts/ and logs/ are

A directory may come from anybody. Nothing in it leads out of it, neither a name in its config nor a
symbolic link; and code that its config names runs only if the user has named it (config/named.py).
"""

import contextlib
import itertools
import json
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from cgm_jax.config.components import NAMES
from cgm_jax.config.fields import SettingError
from cgm_jax.config.grid import Group, Run
from cgm_jax.config.named import absolute, is_own, require_named
from cgm_jax.config.shards import Shard
from cgm_jax.storage.arrays import write_arrays
from cgm_jax.storage.checkpoints import epochs_begun, holds_config, restore_config
from cgm_jax.storage.config_file import (
    UNREADABLE,
    attribute_of,
    check_name,
    damaged,
    group_of,
    own_names,
    read_config,
    recorded_names,
    renamed,
)
from cgm_jax.storage.files import replacing
from cgm_jax.storage.formats import FORMAT, upgraded
from cgm_jax.storage.layout import CONFIG, METRICS, START, TABLE, check_parts
from cgm_jax.storage.lock import locked
from cgm_jax.storage.metrics import Row, check_row, to_csv, to_lines
from cgm_jax.storage.provenance import changes, moved_path, provenance


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
            fresh: whether it must not hold a sweep yet.

        Raises:
            SettingError: it cannot be written to, it is not fresh, or a part of it leads elsewhere.
            InUseError: another process has it.
        """
        check_parts(path)
        with contextlib.ExitStack() as stack:
            try:
                for part in ("policies/improvements", "figures", "checkpoints"):
                    (path / part).mkdir(parents=True, exist_ok=True)
                stack.enter_context(locked(path))
            except OSError as error:
                raise SettingError(f"out: cannot write to {path}: {error.strerror}") from None
            if fresh and any((path / name).exists() for name in (CONFIG, METRICS)):
                raise SettingError(f"out: {path} already holds a sweep; name another directory")
            yield cls(path)

    @classmethod
    def open(cls, path: Path) -> "RunDirectory":
        """A directory that a sweep has written.

        Raises:
            SettingError: it holds none, or a part of it leads elsewhere.
        """
        if not cls(path).holds_sweep():
            raise SettingError(f"{path} holds no sweep: {CONFIG} is missing")
        check_parts(path)
        return cls(path)

    def holds_sweep(self) -> bool:
        """Whether a sweep has been begun here."""
        try:
            return (self.path / CONFIG).is_file()
        except OSError:  # such as a name that is too long
            return False

    def write_config(
        self,
        groups: list[Group],
        preset: str,
        device: str,
        shard: Shard | None = None,
        origin: str | None = None,
    ) -> None:
        """Record how to run the sweep again.

        Args:
            groups: what is trained.
            preset: with which it began.
            device: what JAX computes on.
            shard: of which sweep the groups are a part, if they are one.
            origin: what it starts from, of which start.npz has the arrays; None for from scratch.

        Raises:
            SettingError: a run's name cannot be that of a file.
        """
        for group in groups:
            for run in group.runs:
                check_name(run.name)
        self.replace_config(
            {
                "format": FORMAT,
                "command": ["python", "-m", f"cgm_jax.{Path(sys.argv[0]).stem}", *sys.argv[1:]],
                "preset": preset,
                "started": _now(),
                **({} if shard is None else {"shard": asdict(shard)}),
                **({} if origin is None else {"from": origin}),
                "groups": [
                    {"runs": [{"name": run.name, **run.values} for run in group.runs]}
                    for group in groups
                ],
                **provenance(device, own_names(groups)),
            }
        )

    def replace_config(self, config: Mapping[str, Any]) -> None:
        """Make this the config.

        Raises:
            OSError: it cannot be written.
        """
        with replacing(self.path / CONFIG, durable=True) as file:
            file.write((json.dumps(config, indent=2) + "\n").encode())

    def config_bytes(self) -> bytes:
        """What config.json holds; nothing if it cannot be read."""
        try:
            return (self.path / CONFIG).read_bytes()
        except OSError:
            return b""

    def restore_config(self) -> str | None:
        """Bring a lost or torn config.json back from a checkpoint; return a line if that was done.

        Raises:
            SettingError: it cannot be written, or a part of the directory leads elsewhere.
        """
        check_parts(self.path)
        try:
            return restore_config(self.path / CONFIG, self.path / "checkpoints")
        except OSError as error:
            raise SettingError(f"out: cannot write to {self.path}: {error.strerror}") from None

    def config(self) -> dict[str, Any]:
        """What config.json says, in the present format, unchecked but for its outline.

        Raises:
            SettingError: it is damaged, or of a newer version.
        """
        try:
            config = upgraded(self._config())
            for group in config["groups"]:
                for run in group["runs"]:
                    check_name(run["name"])
        except UNREADABLE as error:
            raise self._damaged(error) from None
        return config

    def shard(self) -> Shard | None:
        """Of which sweep the directory holds a part; None if it holds a whole one.

        Raises:
            SettingError: the config is damaged.
        """
        try:
            entry = self._config().get("shard")
            if entry is None:
                return None
            shard = Shard(**{**entry, "swept": tuple(entry["swept"])})
            numbers, texts = (shard.part, shard.parts), (shard.sweep, *shard.swept)
            if {type(number) for number in numbers} != {int} or not 1 <= shard.part <= shard.parts:
                raise ValueError(f"shard {shard.part!r:.20} of {shard.parts!r:.20}")
            if not all(isinstance(text, str) for text in texts):
                raise TypeError("shard: its names are no text")
        except UNREADABLE as error:
            raise self._damaged(error) from None
        return shard

    def groups(self, moved: Mapping[str, str] | None = None) -> list[Group]:
        """The sweep's groups of runs, read back from its config.

        Args:
            moved: as `moved` returns it.

        Raises:
            SettingError: the config is damaged, or names code that the user has not named.
        """
        try:
            config = renamed(upgraded(self._config()), moved or {})
            own = [(kind, text) for kind in NAMES for text in recorded_names(config, kind)]
        except UNREADABLE as error:
            raise self._damaged(error) from None
        for kind, text in own:  # before anything is made of them
            if is_own(text):
                require_named(kind, text)
        try:
            groups = [group_of(entry) for entry in config["groups"]]
            names = [run.name for group in groups for run in group.runs]
            if not names or len(set(names)) < len(names):
                raise ValueError("it needs runs, each with a name of its own")
        except UNREADABLE as error:
            raise self._damaged(error) from None
        return groups

    def moved(self, named: Mapping[str, Sequence[str]]) -> dict[str, str]:
        """Own code of the sweep that the user has named again, elsewhere.

        Args:
            named: by setting, what the user names now.

        Returns:
            From what the config calls it to what the user does. What is where it was is not in it.

        Raises:
            SettingError: the config is damaged, or something named cannot be what it trains with.
        """
        moved: dict[str, str] = {}
        for kind, texts in named.items():
            try:
                recorded = recorded_names(upgraded(self._config()), kind)
            except UNREADABLE as error:
                raise self._damaged(error) from None
            asked = {absolute(text) for text in texts}
            gone = [text for text in recorded if is_own(text) and text not in asked]
            for text in sorted(asked - {*recorded}):
                before = [old for old in gone if attribute_of(old) == attribute_of(text)]
                if not is_own(text) or len(before) != 1 or before[0] in moved:
                    there = ", ".join(recorded) or "none"
                    raise SettingError(f"{kind}: {self.path} was trained with {there}, not {text}")
                moved[before[0]] = text
        return moved

    def changes_since_begun(
        self, device: str, groups: Sequence[Group], moved: Mapping[str, str]
    ) -> list[str]:
        """What differs from when the sweep began, of all that results depend on.

        Args:
            device: what JAX computes on now.
            groups: of the sweep, whose own code has been loaded.
            moved: as `moved` returns it.

        Raises:
            SettingError: the config is damaged.
        """
        try:
            return changes(self._config(), provenance(device, own_names(groups)), moved)
        except UNREADABLE as error:
            raise self._damaged(error) from None

    def record_resumption(
        self, changed: Sequence[str], moved: Mapping[str, str], epochs: int | None = None
    ) -> None:
        """Add to the config what had changed when the sweep was resumed, and what has moved.

        Args:
            changed: as `changes_since_begun` returns it, and what else is worth a record.
            moved: as `moved` returns it.
            epochs: that all runs are trained for from now on; None for what they were begun with.

        Raises:
            OSError: it cannot be written.
            SettingError: the config is damaged.
        """
        if not changed:
            return
        try:
            config = self._config()
            files = config.get("files", {})
            entry = {"time": _now(), "changed": list(changed)}
            if epochs is not None:
                config = upgraded(config)
                for values in (values for group in config["groups"] for values in group["runs"]):
                    values["epochs"] = epochs
            config |= {
                "groups": renamed(config["groups"], moved),
                "files": {str(moved_path(name, moved)): files[name] for name in files},
                "resumed": [*config.get("resumed", []), entry],
            }
        except UNREADABLE as error:
            raise self._damaged(error) from None
        self.replace_config(config)

    def _config(self) -> Any:
        return read_config(self.path / CONFIG)

    def _damaged(self, error: Exception) -> SettingError:
        complaint = damaged(self.path / CONFIG, error)
        if not holds_config(self.path / "checkpoints"):
            return complaint
        return SettingError(f"{complaint}; without this file it comes back from a checkpoint")

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
        """How many lines metrics.jsonl has, whole or torn; None if it is not there."""
        path = self.path / METRICS
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
            return [json.loads(line) for line in file if line.endswith("\n")]

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
            written = [int(row["epoch"]) for row in self.metrics()]
        except (OSError, *UNREADABLE):  # checkpoints will restore them
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


def _now() -> str:
    return datetime.now(UTC).isoformat(timespec="seconds")
