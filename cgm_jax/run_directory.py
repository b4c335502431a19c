"""What a sweep writes, and where.

DIR/config.json           everything needed to run it again, versions included
DIR/metrics.jsonl         one object per run and epoch
DIR/policies/<run>.npz    the deterministic actor
DIR/figures/*.png
DIR/checkpoints/          the whole training state of each group
"""

import importlib.metadata
import json
import math
import os
import platform
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from cgm_jax.grid import Group, Run
from cgm_jax.settings import Hyperparameters, SettingError, Settings

PACKAGES = ("cgm_jax", "jax", "jaxlib", "mujoco", "mujoco-mjx", "flax", "optax", "brax", "numpy")
METRICS = "metrics.jsonl"
CONFIG = "config.json"


@dataclass(frozen=True)
class RunDirectory:
    """The directory of one sweep."""

    path: Path

    @classmethod
    def create(cls, path: Path) -> "RunDirectory":
        """Claim a directory for a new sweep, before anything costly happens.

        Raises:
            SettingError: it holds a sweep already, or cannot be written to.
        """
        try:
            if (path / CONFIG).exists() or (path / METRICS).exists():
                raise SettingError(f"out: {path} already holds a sweep; name another directory")
            for part in ("policies", "figures", "checkpoints"):
                (path / part).mkdir(parents=True, exist_ok=True)
            (path / METRICS).touch()
        except OSError as error:
            raise SettingError(f"out: cannot write to {path}: {error.strerror}") from None
        return cls(path)

    @classmethod
    def open(cls, path: Path) -> "RunDirectory":
        """A directory that a sweep has written.

        Raises:
            SettingError: it holds none.
        """
        if not (path / CONFIG).is_file():
            raise SettingError(f"{path} holds no sweep: {CONFIG} is missing")
        return cls(path)

    def write_config(self, groups: list[Group], preset: str, device: str) -> None:
        """Record how to run the sweep again; `device` names what JAX computes on."""
        config = {
            "command": ["python", "-m", f"cgm_jax.{Path(sys.argv[0]).stem}", *sys.argv[1:]],
            "preset": preset,
            "started": datetime.now(UTC).isoformat(timespec="seconds"),
            "groups": [
                {
                    "settings": asdict(group.settings),
                    "runs": [{"name": run.name, **asdict(run.hyper)} for run in group.runs],
                }
                for group in groups
            ],
            "versions": {name: importlib.metadata.version(name) for name in PACKAGES},
            "python": platform.python_version(),
            "commit": _commit(),
            "device": device,
            "flags": os.environ.get("XLA_FLAGS", ""),
            "machine": f"{platform.platform()}, {os.cpu_count()} cores",
        }
        (self.path / CONFIG).write_text(json.dumps(config, indent=2) + "\n")

    def groups(self) -> list[Group]:
        """The sweep's groups of runs, read back from its config."""
        groups = []
        for entry in json.loads((self.path / CONFIG).read_text())["groups"]:
            settings = entry["settings"]
            settings["hidden_layers"] = tuple(settings["hidden_layers"])
            runs = [dict(run) for run in entry["runs"]]
            groups.append(
                Group(
                    Settings(**settings),
                    tuple(Run(run.pop("name"), Hyperparameters(**run)) for run in runs),
                )
            )
        return groups

    def append_metrics(self, rows: list[dict[str, Any]]) -> None:
        """Add one line per row; a number that does not exist (0 / 0) becomes null."""
        with (self.path / METRICS).open("a") as file:
            file.writelines(json.dumps(_plain(row)) + "\n" for row in rows)

    def metrics(self) -> list[dict[str, Any]]:
        """All lines of metrics.jsonl."""
        with (self.path / METRICS).open() as file:
            return [json.loads(line) for line in file]

    def policy_path(self, run: Run) -> Path:
        """Where a run's policy lies."""
        return self.path / "policies" / f"{run.name}.npz"

    def write_policy(self, run: Run, arrays: Mapping[str, np.ndarray]) -> None:
        """Write or replace a run's policy; a reader never sees half a file."""
        path = self.policy_path(run)
        partial = path.with_suffix(".partial.npz")
        np.savez(partial, **arrays)  # pyright: ignore[reportArgumentType]
        partial.replace(path)


def _commit() -> str | None:
    """The commit of this checkout, marked if it has changes; None in an installed wheel."""
    checkout = Path(__file__).parents[1]
    if not (checkout / ".git").exists():
        return None
    git = ["git", "-C", str(checkout), "describe", "--always", "--dirty", "--abbrev=12"]
    try:
        result = subprocess.run(git, capture_output=True, text=True, check=False)
    except OSError:
        return None
    return result.stdout.strip() or None


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
