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
import os
import stat
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from cgm_jax.config.components import NAMES
from cgm_jax.config.fields import SettingError
from cgm_jax.config.grid import Group, Run, run_of, structure
from cgm_jax.config.named import absolute, is_own, require_named
from cgm_jax.config.run_names import MAX_NAME
from cgm_jax.config.shards import Shard
from cgm_jax.storage.arrays import write_arrays
from cgm_jax.storage.checkpoints import epochs_begun, holds_config, restore_config
from cgm_jax.storage.files import replacing
from cgm_jax.storage.formats import FORMAT, upgraded
from cgm_jax.storage.lock import HOLDER, LOCK, locked
from cgm_jax.storage.metrics import Row, check_row, to_csv, to_lines
from cgm_jax.storage.provenance import changes, moved_path, provenance

START = "start.npz"
METRICS, TABLE = "metrics.jsonl", "metrics.csv"
CONFIG = "config.json"
PARTS = (
    *(CONFIG, START, METRICS, TABLE, LOCK, HOLDER),
    *("policies", "figures", "checkpoints", "tracking"),
    *("launch.json", "parts", "attempts", "logs"),
)

WANDB_LOG = "debug-core.log"

UNREADABLE = (KeyError, TypeError, AttributeError, ValueError, RecursionError)
"""What reading a config raises whose values are of other types than they should be."""

MAX_CONFIG_BYTES = 2**28
"""Of a config with as many runs as a sweep may have."""


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
                _check_name(run.name)
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
                **provenance(device, _own_names(groups)),
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
                    _check_name(run["name"])
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
            config = _renamed(upgraded(self._config()), moved or {})
            own = [(kind, text) for kind in NAMES for text in _recorded(config, kind)]
        except UNREADABLE as error:
            raise self._damaged(error) from None
        for kind, text in own:  # before anything is made of them
            if is_own(text):
                require_named(kind, text)
        try:
            groups = [_group(entry) for entry in config["groups"]]
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
                recorded = _recorded(upgraded(self._config()), kind)
            except UNREADABLE as error:
                raise self._damaged(error) from None
            asked = {absolute(text) for text in texts}
            gone = [text for text in recorded if is_own(text) and text not in asked]
            for text in sorted(asked - {*recorded}):
                before = [old for old in gone if _attribute(old) == _attribute(text)]
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
            return changes(self._config(), provenance(device, _own_names(groups)), moved)
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
                "groups": _renamed(config["groups"], moved),
                "files": {str(moved_path(name, moved)): files[name] for name in files},
                "resumed": [*config.get("resumed", []), entry],
            }
        except UNREADABLE as error:
            raise self._damaged(error) from None
        self.replace_config(config)

    def _config(self) -> Any:
        return _read_config(self.path / CONFIG)

    def _damaged(self, error: Exception) -> SettingError:
        damaged = _damaged(self.path / CONFIG, error)
        if not holds_config(self.path / "checkpoints"):
            return damaged
        return SettingError(f"{damaged}; without this file it comes back from a checkpoint")

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
            raise _damaged(self.path / METRICS, error) from None
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


def read_groups(path: Path) -> list[dict[str, dict[str, Any]]]:
    """All values of each run of a config.json, by group and name; nothing that it names runs.

    Raises:
        SettingError: the file cannot be read, or is no config.json.
    """
    try:
        groups = upgraded(_read_config(path))["groups"]
        named = [[_named_values(values) for values in group["runs"]] for group in groups]
        names = [name for group in named for name, _ in group]
        if not names or len({*names}) < len(names):
            raise ValueError("it needs runs, each with a name of its own")
        return [dict(group) for group in named]
    except UNREADABLE as error:
        raise _damaged(path, error) from None


def start_beside(config: Path) -> Path | None:
    """The arrays that the sweep of a config.json started from; None for from scratch.

    Raises:
        SettingError: they are not beside it, or it cannot be read.
    """
    origin, start = read_origin(config), config.with_name(START)
    if origin is None:
        return None
    if not start.is_file():
        raise SettingError(f"from: {config} began from {origin}, but {start} is missing")
    return start


def read_origin(path: Path) -> str | None:
    """What the sweep of a config.json started from, as it was named; None for from scratch.

    Raises:
        SettingError: the file cannot be read.
    """
    try:
        origin = _read_config(path).get("from")
    except UNREADABLE as error:
        raise _damaged(path, error) from None
    return None if origin is None else str(origin)


def _read_config(path: Path) -> Any:
    try:
        if path.stat().st_size > MAX_CONFIG_BYTES:
            raise ValueError(f"it has more than {MAX_CONFIG_BYTES:,} bytes")
        return json.loads(path.read_bytes())
    except (OSError, ValueError, RecursionError) as error:
        raise _damaged(path, error) from None


def _damaged(path: Path, error: Exception) -> SettingError:
    kind = "" if isinstance(error, SettingError) else f"{type(error).__name__}: "
    text = str(error).partition("\n")[0]
    return SettingError(f"{path} is damaged: {kind}{text}")


def _named_values(entry: Any) -> tuple[str, dict[str, Any]]:
    """A run's name and values from its entry in the config; whatever is wrong with it raises."""
    values = dict(entry)
    name = values.pop("name")
    _check_name(name)
    for key, value in values.items():
        if isinstance(value, list):  # JSON knows no tuples
            values[key] = tuple(value)
    return name, values


def _group(entry: Any) -> Group:
    """A group of runs from its entry in the config; whatever is wrong with it raises."""
    pairs = [run_of(*_named_values(values)) for values in entry["runs"]]
    settings = {structure(static, run.hyper): static for static, run in pairs}
    ((_, static),) = settings.items()  # runs of one group share a program
    return Group(static, tuple(run for _, run in pairs))


def _recorded(config: Any, kind: str) -> list[str]:
    """What a config's runs have as their environment, or as another setting that is a name."""
    runs = [run for group in config["groups"] for run in group["runs"] if kind in run]
    return list(dict.fromkeys(run[kind] for run in runs if isinstance(run[kind], str)))


def _renamed(values: Any, names: Mapping[str, str]) -> Any:
    """A config, or a part of it, with other names for own code."""
    if isinstance(values, str):
        return names.get(values, values)
    if isinstance(values, dict):
        return {key: _renamed(value, names) for key, value in values.items()}
    return [_renamed(value, names) for value in values] if isinstance(values, list) else values


def _own_names(groups: Sequence[Group]) -> list[str]:
    names = [run.values.get(kind) for group in groups for run in group.runs for kind in NAMES]
    return list(dict.fromkeys(name for name in names if name and is_own(name)))


def _attribute(text: str) -> str:
    return text.rpartition(":")[2]


def _check_name(name: Any) -> None:
    """Check that a run's name is one of a file, in whichever directory it is put.

    Raises:
        ValueError: it is not.
    """
    valid = isinstance(name, str) and name.isprintable() and not {*"/\\"} & {*name}
    if not valid or not 0 < len(name.encode()) <= MAX_NAME:
        raise SettingError(f"run: {str(name)[:60]!r} is no name for a file")


def check_parts(path: Path) -> None:
    """Check that all parts of a run directory are ordinary files and directories.

    A symbolic link in a directory from elsewhere would have a sweep write wherever it leads to. One
    that wandb makes beside its log is left alone, since nothing here opens it.

    Raises:
        SettingError: one is not.
    """
    for part in PARTS:
        for folder, folders, files in [(path, [part], []), *os.walk(path / part)]:
            for name in (*folders, *files):
                found = Path(folder) / name
                kept = found.relative_to(path).parts
                if name == WANDB_LOG and Path(folder).name == "logs" and "tracking" in kept:
                    continue
                try:
                    mode = found.lstat().st_mode
                except OSError:  # there is none
                    continue
                if not stat.S_ISREG(mode) and not stat.S_ISDIR(mode):
                    kind = "a symbolic link" if stat.S_ISLNK(mode) else "no ordinary file"
                    raise SettingError(f"{found} is {kind}, which a run directory may not hold")


def _now() -> str:
    return datetime.now(UTC).isoformat(timespec="seconds")
