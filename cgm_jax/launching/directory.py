"""The directory of a launch: what was launched, and the paths and the command of each part."""

import json
import os
import sys
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from cgm_jax.config.fields import SettingError
from cgm_jax.config.named import absolute
from cgm_jax.launching.attempts import Order
from cgm_jax.storage.files import replacing
from cgm_jax.storage.layout import LAUNCH, check_parts, why_it_holds_none
from cgm_jax.storage.untrusted import UNREADABLE, read_json

FORMAT = 1
CHECKPOINT_SECONDS = 60
"""Between checkpoints, at least, unless the sweep says otherwise."""

CARRIED = ("JAX_", "XLA_", "MUJOCO_", "CGM_JAX_", "PYTHONPATH", "XDG_STATE_HOME")
"""Variables that go along to other machines, by how their names begin."""

MAX_BYTES = 2**24

ANY_CLUSTER = "auto"
"""For Ray: the cluster of this machine, or of RAY_ADDRESS."""


@dataclass(frozen=True)
class Resources:
    """What each part is given.

    Attributes:
        cores: of a CPU; None for as many as there are to share.
        gpus: None for one where there is one.
        memory: GiB; None for a share, or the scheduler's default.
        minutes: time limit of an attempt, for SLURM.
        sbatch: further options of sbatch, KEY=VALUE.
        address: of the Ray cluster.
    """

    cores: int | None = None
    gpus: int | None = None
    memory: float | None = None
    minutes: int = 60
    sbatch: tuple[str, ...] = ()
    address: str = ANY_CLUSTER


@dataclass(frozen=True)
class Launch:
    """A sweep in parts.

    Attributes:
        path: of the launch's directory, absolute.
        on: the engine.
        parts: how many.
        preset: of the sweep.
        sweep: options of the sweep, without --out and --shard.
        resources: of each part.
    """

    path: Path
    on: str
    parts: int
    preset: str
    sweep: tuple[str, ...]
    resources: Resources

    def out(self, part: int) -> Path:
        """A part's run directory."""
        return self.path / "parts" / str(part)

    def record(self, part: int) -> Path:
        """The record of a part's attempts."""
        return self.path / "attempts" / f"{part}.jsonl"

    def log(self, part: int) -> Path:
        """What a part printed."""
        return self.path / "logs" / f"{part}.log"

    def command(self, part: int) -> list[str]:
        """What trains a part; the same at each attempt, which is how a sweep resumes."""
        words = list(self.sweep)
        if not any(word.replace("_", "-").startswith("--checkpoint-seconds") for word in words):
            words += ["--checkpoint-seconds", str(CHECKPOINT_SECONDS)]
        shard = ["--shard", f"{part}/{self.parts}", "--out", str(self.out(part))]
        return [sys.executable, "-m", "cgm_jax.sweep", *words, *shard]

    def order(
        self,
        part: int,
        cores: int | None,
        environment: Mapping[str, str] | None = None,
        *,
        session: bool = False,
    ) -> Order:
        """All that an attempt at a part needs to know; see `Order`."""
        return Order(
            command=self.command(part),
            out=str(self.out(part)),
            record=str(self.record(part)),
            log=str(self.log(part)),
            cwd=str(Path.cwd()),
            cores=cores,
            environment=dict(environment or {}),
            session=session,
        )

    def write(self) -> None:
        """Record what is launched, and make the folders of the parts.

        Raises:
            OSError: they cannot be written.
        """
        for name in ("parts", "attempts", "logs"):
            (self.path / name).mkdir(exist_ok=True)
        entry = {
            "format": FORMAT,
            "on": self.on,
            "parts": self.parts,
            "preset": self.preset,
            "sweep": self.sweep,
            "resources": asdict(self.resources),
        }
        with replacing(self.path / LAUNCH, durable=True) as file:
            file.write((json.dumps(entry, indent=2) + "\n").encode())


def read_launch(path: Path) -> Launch:
    """What was launched in a directory, which may come from anybody.

    Raises:
        SettingError: nothing was, it cannot be read, or a part of the directory leads elsewhere.
    """
    check_parts(path)
    file = path / LAUNCH
    try:
        entry = read_json(file, MAX_BYTES)
        if entry["format"] != FORMAT:
            raise ValueError(f"its format is {entry['format']!r:.20}")
        return Launch(
            path=absolute_path(path),
            on=_typed(entry["on"], str),
            parts=_typed(entry["parts"], int),
            preset=_typed(entry["preset"], str),
            sweep=tuple(_typed(word, str) for word in entry["sweep"]),
            resources=_resources(entry["resources"]),
        )
    except (FileNotFoundError, NotADirectoryError):
        raise SettingError(f"resume: {why_it_holds_none(path, LAUNCH)}") from None
    except OSError as error:
        raise SettingError(f"resume: cannot read {file}: {error.strerror}") from None
    except UNREADABLE as error:
        text = str(error).partition("\n")[0]
        raise SettingError(f"{file} is damaged: {type(error).__name__}: {text}") from None


def _resources(entry: Mapping[str, Any]) -> Resources:
    for name, kinds in {"cores": int, "gpus": int, "memory": int | float}.items():
        if not isinstance(entry[name], kinds | None):
            raise TypeError(f"{name} is {entry[name]!r:.20}")
    return Resources(
        cores=entry["cores"],
        gpus=entry["gpus"],
        memory=entry["memory"],
        minutes=_typed(entry["minutes"], int),
        sbatch=tuple(_typed(text, str) for text in entry["sbatch"]),
        address=_typed(entry["address"], str),
    )


def _typed(value: Any, kind: type) -> Any:
    if type(value) is not kind:
        raise TypeError(f"{value!r:.40} is no {kind.__name__}")
    return value


def absolute_path(path: Path) -> Path:
    """A path from the root, without `..`, but with its symbolic links."""
    return Path(os.path.abspath(path))  # noqa: PTH100


def absolute_words(words: Sequence[str]) -> tuple[str, ...]:
    """Options of a sweep that hold in any working directory."""
    made = []
    for word in words:
        option, equals, value = word.partition("=")
        if equals and option.startswith("--"):
            made.append(f"{option}={absolute(value)}")
        else:
            made.append(absolute(word))
    return tuple(made)


def carried_environment() -> dict[str, str]:
    """Variables that attempts on other machines are to have as this process does.

    Among them is where the list of allowed files lies (config/allowed.py): files of the user's own
    that a part runs are remembered there, as if it ran here.
    """
    own = {name: value for name, value in os.environ.items() if name.startswith(CARRIED)}
    home = os.environ.get("HOME")
    if "XDG_STATE_HOME" not in own and home:
        own["XDG_STATE_HOME"] = str(Path(home) / ".local" / "state")
    return own
