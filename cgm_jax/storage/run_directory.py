"""What a sweep writes, and where.

DIR/config.json           everything needed to run it again, versions included
DIR/metrics.jsonl         one object per run and epoch
DIR/policies/<run>.npz    the deterministic actor; improvements/ has each that was the best so far
DIR/figures/*.png
DIR/checkpoints/          the whole training state of each group, see checkpoint.py
DIR/lock                  held while a sweep writes here

A directory may come from anybody. Nothing in it leads out of it, neither a name in its config nor a
symbolic link; and code that its config names runs only if the user has named it (config/named.py).
"""

import contextlib
import json
import math
import os
import stat
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from cgm_jax.config.grid import LONGEST_NAME, Group, Run
from cgm_jax.config.named import absolute, is_own, own_names, require_named
from cgm_jax.config.settings import Hyperparameters, SettingError, Settings, check
from cgm_jax.storage.arrays import write_arrays
from cgm_jax.storage.files import replacing
from cgm_jax.storage.lock import locked
from cgm_jax.storage.provenance import changes, moved_path, provenance

METRICS = "metrics.jsonl"
CONFIG = "config.json"
PARTS = (CONFIG, METRICS, "lock", "policies", "figures", "checkpoints")

GREATEST_CONFIG_BYTES = 2**28
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
            SettingError: it cannot be written to, another process has it, it is not fresh, or a
                part of it leads elsewhere.
        """
        _check_parts(path)
        with contextlib.ExitStack() as stack:
            try:
                for part in ("policies/improvements", "figures", "checkpoints"):
                    (path / part).mkdir(parents=True, exist_ok=True)
                stack.enter_context(locked(path / "lock"))
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
        _check_parts(path)
        return cls(path)

    def holds_sweep(self) -> bool:
        """Whether a sweep has been begun here."""
        try:
            return (self.path / CONFIG).is_file()
        except OSError:  # such as a name that is too long
            return False

    def write_config(self, groups: list[Group], preset: str, device: str) -> None:
        """Record how to run the sweep again; `device` names what JAX computes on.

        Raises:
            SettingError: a run's name cannot be that of a file.
        """
        for group in groups:
            for run in group.runs:
                _check_name(run.name)
        config = {
            "command": ["python", "-m", f"cgm_jax.{Path(sys.argv[0]).stem}", *sys.argv[1:]],
            "preset": preset,
            "started": _now(),
            "groups": [
                {
                    "settings": asdict(group.settings),
                    "runs": [{"name": run.name, **asdict(run.hyper)} for run in group.runs],
                }
                for group in groups
            ],
            **provenance(device, _own_names(groups)),
        }
        self._write_config(config)

    def _write_config(self, config: Mapping[str, Any]) -> None:
        with replacing(self.path / CONFIG, durable=True) as file:
            file.write((json.dumps(config, indent=2) + "\n").encode())

    def groups(self, moved: Mapping[str, str] | None = None) -> list[Group]:
        """The sweep's groups of runs, read back from its config.

        Args:
            moved: as `moved` returns it.

        Raises:
            SettingError: the config is damaged, or names code that the user has not named.
        """
        try:
            groups = [_group(entry) for entry in self._config()["groups"]]
            names = [run.name for group in groups for run in group.runs]
            if not names or len(set(names)) < len(names):
                raise ValueError("it needs runs, each with a name of its own")
        except (KeyError, TypeError, AttributeError, ValueError, RecursionError) as error:
            raise self._damaged(error) from None
        groups = [_with_env(group, (moved or {}).get(group.settings.env)) for group in groups]
        for group in groups:
            for setting, text in own_names(asdict(group.settings)):
                require_named(setting, text)
        return groups

    def moved(self, named: Sequence[str]) -> dict[str, str]:
        """Environments of the sweep that the user has named again, elsewhere.

        Args:
            named: environments as the user names them now.

        Returns:
            From what the config calls them to what the user does. Those that are where they were
            are not in it.

        Raises:
            SettingError: the config is damaged, or one of `named` cannot be one of the sweep's.
        """
        try:
            recorded = {entry["settings"]["env"] for entry in self._config()["groups"]}
            asked = {absolute(text) for text in named}
            own = [text for text in recorded - asked if is_own(text)]
        except (KeyError, TypeError, AttributeError) as error:
            raise self._damaged(error) from None
        moved = {}
        for text in asked - recorded:
            before = [old for old in own if _attribute(old) == _attribute(text)]
            if not is_own(text) or len(before) != 1 or before[0] in moved:
                trained = ", ".join(sorted(recorded))
                raise SettingError(f"env: {self.path} was trained on {trained}, not on {text}")
            moved[before[0]] = text
        return moved

    def changes_since_begun(
        self, device: str, groups: Sequence[Group], moved: Mapping[str, str]
    ) -> list[str]:
        """Whatever results depend on that is another than when the sweep began.

        Args:
            device: what JAX computes on now.
            groups: of the sweep, whose environments have been made.
            moved: as `moved` returns it.

        Raises:
            SettingError: the config is damaged.
        """
        try:
            return changes(self._config(), provenance(device, _own_names(groups)), moved)
        except (KeyError, TypeError, AttributeError) as error:
            raise self._damaged(error) from None

    def record_resumption(self, changed: Sequence[str], moved: Mapping[str, str]) -> None:
        """Add to the config what had changed when the sweep was resumed, and what has moved.

        Raises:
            OSError: it cannot be written.
            SettingError: the config is damaged.
        """
        if not changed:
            return
        config = self._config()
        try:
            for entry in config["groups"]:
                env = entry["settings"]["env"]
                entry["settings"]["env"] = moved.get(env, env)
            files = config.get("files", {})
            config["files"] = {str(moved_path(name, moved)): files[name] for name in files}
            config["resumed"] = [
                *config.get("resumed", []),
                {"time": _now(), "changed": list(changed)},
            ]
        except (KeyError, TypeError, AttributeError) as error:
            raise self._damaged(error) from None
        self._write_config(config)

    def _config(self) -> Any:
        path = self.path / CONFIG
        try:
            if path.stat().st_size > GREATEST_CONFIG_BYTES:
                raise ValueError(f"more than {GREATEST_CONFIG_BYTES:,} bytes")
            return json.loads(path.read_bytes())
        except (OSError, ValueError, RecursionError) as error:
            raise self._damaged(error) from None

    def _damaged(self, error: Exception) -> SettingError:
        kind = "" if isinstance(error, SettingError) else f"{type(error).__name__}: "
        text = str(error).partition("\n")[0]
        return SettingError(f"{self.path / CONFIG} is damaged: {kind}{text}")

    def append_metrics(self, rows: Sequence[str]) -> None:
        """Add lines to metrics.jsonl.

        Raises:
            OSError: they cannot be written.
        """
        with (self.path / METRICS).open("a") as file:
            file.writelines(rows)

    def replace_metrics(self, rows: Sequence[str]) -> None:
        """Make these the only lines of metrics.jsonl.

        Raises:
            OSError: they cannot be written.
        """
        with replacing(self.path / METRICS, durable=True) as file:
            file.writelines(row.encode() for row in rows)

    def metrics(self) -> list[dict[str, Any]]:
        """All lines of metrics.jsonl, less one that a killed process left half written."""
        with (self.path / METRICS).open() as file:
            return [json.loads(line) for line in file if line.endswith("\n")]

    def policy_path(self, run: Run) -> Path:
        """Where a run's policy lies."""
        return self.path / "policies" / f"{run.name}.npz"

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


def metrics_line(row: Mapping[str, Any]) -> str:
    """A line of metrics.jsonl; a number that does not exist (0 / 0) becomes null."""
    return json.dumps(_plain(dict(row))) + "\n"


def _write_npz(path: Path, arrays: Mapping[str, np.ndarray]) -> None:
    with replacing(path) as file:
        write_arrays(file, arrays.items())


def _group(entry: Any) -> Group:
    """A group of runs from its entry in the config; whatever is wrong with it raises."""
    settings = dict(entry["settings"])
    settings["hidden_layers"] = tuple(settings["hidden_layers"])
    runs = []
    for values in entry["runs"]:
        hyper = {name: value for name, value in values.items() if name != "name"}
        _check_name(values["name"])
        runs.append(Run(values["name"], Hyperparameters(**hyper)))
        check(runs[-1].hyper)
    return Group(Settings(**settings), tuple(runs))


def _with_env(group: Group, env: str | None) -> Group:
    return replace(group, settings=replace(group.settings, env=env)) if env else group


def _own_names(groups: Sequence[Group]) -> list[str]:
    names = (text for group in groups for _, text in own_names(asdict(group.settings)))
    return list(dict.fromkeys(names))


def _attribute(text: str) -> str:
    return text.rpartition(":")[2]


def _check_name(name: Any) -> None:
    """Check that a run's name is one of a file, in whichever directory it is put.

    Raises:
        ValueError: it is not.
    """
    sound = isinstance(name, str) and name.isprintable() and not {*"/\\"} & {*name}
    if not sound or not 0 < len(name.encode()) <= LONGEST_NAME:
        raise SettingError(f"run: {str(name)[:60]!r} is no name for a file")


def _check_parts(path: Path) -> None:
    """Check that all parts of a run directory are ordinary files and directories.

    A symbolic link in a directory from elsewhere would have a sweep write wherever it leads to.

    Raises:
        SettingError: one is not.
    """
    for part in PARTS:
        for folder, folders, files in [(path, [part], []), *os.walk(path / part)]:
            for name in (*folders, *files):
                found = Path(folder) / name
                try:
                    mode = found.lstat().st_mode
                except OSError:  # there is none
                    continue
                if not stat.S_ISREG(mode) and not stat.S_ISDIR(mode):
                    kind = "a symbolic link" if stat.S_ISLNK(mode) else "no ordinary file"
                    raise SettingError(f"{found} is {kind}, which a run directory may not hold")


def _now() -> str:
    return datetime.now(UTC).isoformat(timespec="seconds")


def _plain(value: Any) -> Any:
    """Arrays to lists and numbers, NaN and infinities to None."""
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, np.ndarray | np.generic):
        array = np.asarray(value)
        if np.issubdtype(array.dtype, np.floating):  # float32 has seven digits
            array = array.astype(np.float64).round(7)
        return _plain(array.tolist())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
