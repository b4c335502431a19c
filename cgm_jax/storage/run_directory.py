"""What a sweep writes, and where.

DIR/config.json           everything needed to run it again, versions included
DIR/metrics.jsonl         one object per run and epoch
DIR/policies/<run>.npz    the deterministic actor; improvements/ has each that was the best so far
DIR/figures/*.png
DIR/checkpoints/          the whole training state of each group, see checkpoint.py
DIR/lock, DIR/holder      held while a sweep writes here, and by whom
"""

import contextlib
import importlib.metadata
import itertools
import json
import math
import os
import platform
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from cgm_jax.config.fields import SettingError
from cgm_jax.config.grid import Group, Run, run_of, structure
from cgm_jax.host.allotment import available_cores
from cgm_jax.storage.arrays import write_arrays
from cgm_jax.storage.checkpoints import restore_config
from cgm_jax.storage.files import replacing
from cgm_jax.storage.formats import FORMAT, upgraded
from cgm_jax.storage.lock import locked

PACKAGES = ("cgm_jax", "jax", "jaxlib", "mujoco", "mujoco-mjx", "flax", "optax", "brax", "numpy")
METRICS = "metrics.jsonl"
CONFIG = "config.json"


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
            SettingError: it cannot be written to, or it is not fresh.
            InUseError: another process has it.
        """
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
            SettingError: it holds none.
        """
        if not cls(path).holds_sweep():
            raise SettingError(f"{path} holds no sweep: {CONFIG} is missing")
        return cls(path)

    def holds_sweep(self) -> bool:
        """Whether a sweep has been begun here."""
        try:
            return (self.path / CONFIG).is_file()
        except OSError:  # such as a name that is too long
            return False

    def write_config(self, groups: list[Group], preset: str, device: str) -> None:
        """Record how to run the sweep again; `device` names what JAX computes on."""
        config = {
            "format": FORMAT,
            "command": ["python", "-m", f"cgm_jax.{Path(sys.argv[0]).stem}", *sys.argv[1:]],
            "preset": preset,
            "started": datetime.now(UTC).isoformat(timespec="seconds"),
            "groups": [
                {"runs": [{"name": run.name, **run.values} for run in group.runs]}
                for group in groups
            ],
            "versions": {name: importlib.metadata.version(name) for name in PACKAGES},
            "python": platform.python_version(),
            "commit": _commit(),
            "device": device,
            "flags": os.environ.get("XLA_FLAGS", ""),
            "machine": _machine(),
        }
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
            SettingError: it cannot be written.
        """
        try:
            return restore_config(self.path / CONFIG, self.path / "checkpoints")
        except OSError as error:
            raise SettingError(f"out: cannot write to {self.path}: {error.strerror}") from None

    def groups(self) -> list[Group]:
        """The sweep's groups of runs, read back from its config.

        Raises:
            SettingError: the config is damaged.
        """
        try:
            return [_group(entry) for entry in upgraded(self._config())["groups"]]
        except (KeyError, TypeError, AttributeError, ValueError) as error:
            raise self._damaged(error) from None

    def changes_since_begun(self) -> list[str]:
        """Packages, and the machine with its cores, that are others than when the sweep began.

        Raises:
            SettingError: the config is damaged.
        """
        try:
            config = self._config()
            before = {name: was for name, was in config["versions"].items() if name in PACKAGES}
            changes = [
                f"{name} {was} (now {now})"
                for name, was in before.items()
                if (now := importlib.metadata.version(name)) != was
            ]
            if config["machine"] != _machine():
                changes.append(f"{config['machine']} (now {_machine()})")
        except (KeyError, TypeError, AttributeError) as error:
            raise self._damaged(error) from None
        return changes

    def _config(self) -> Any:
        try:
            return json.loads((self.path / CONFIG).read_bytes())
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
        with (self.path / METRICS).open("a", encoding="utf-8") as file:
            file.writelines(rows)

    def replace_metrics(self, rows: Sequence[str]) -> None:
        """Make these the only lines of metrics.jsonl.

        Raises:
            OSError: they cannot be written.
        """
        with replacing(self.path / METRICS, durable=True) as file:
            file.writelines(row.encode() for row in rows)

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

    def metrics(self) -> list[dict[str, Any]]:
        """All lines of metrics.jsonl, less one that a killed process left half written."""
        with (self.path / METRICS).open(encoding="utf-8") as file:
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
    pairs = []
    for values in entry["runs"]:
        values = dict(values)
        name = str(values.pop("name"))
        if "hidden_layers" in values:
            values["hidden_layers"] = tuple(values["hidden_layers"])
        pairs.append(run_of(name, values))
    settings = {structure(static, run.hyper): static for static, run in pairs}
    ((_, static),) = settings.items()  # runs of one group share a program
    return Group(static, tuple(run for _, run in pairs))


def _commit() -> str | None:
    """The commit of this checkout, marked if it has changes; None in an installed wheel."""
    checkout = Path(__file__).parents[2]
    if not (checkout / ".git").exists():
        return None
    describe = ["describe", "--always", "--exclude=*", "--abbrev=12", "--dirty"]
    git = ["git", "-C", str(checkout), *describe]
    try:
        result = subprocess.run(git, capture_output=True, text=True, check=False)
    except OSError:
        return None
    return result.stdout.strip() or None


def _machine() -> str:
    """The system, and how many of its cores this process may use: bits depend on both."""
    usable, there = available_cores(), os.cpu_count()
    cores = f"{there} cores" if usable == there else f"{usable} of {there} cores"
    return f"{platform.platform()}, {cores}"


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
