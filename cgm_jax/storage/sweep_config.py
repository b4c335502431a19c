"""The config.json of a run directory: what was asked for, and what has changed since.

It may come from anybody. Whatever is wrong with it is one line, and code that it names runs only if
the user has named it (config/named.py).
"""

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from cgm_jax.config.components import NAMES
from cgm_jax.config.fields import SettingError
from cgm_jax.config.grid import Group
from cgm_jax.config.named import absolute, is_own, require_named
from cgm_jax.config.shards import MAX_PARTS, Shard
from cgm_jax.storage.checkpoints import holds_config, restore_config
from cgm_jax.storage.config_file import (
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
from cgm_jax.storage.layout import CONFIG, check_parts
from cgm_jax.storage.provenance import changes, moved_hosts, moved_path, provenance
from cgm_jax.storage.untrusted import UNREADABLE


@dataclass(frozen=True)
class SweepConfig:
    """What the config.json of a run directory says.

    Attributes:
        directory: in which it lies.
    """

    directory: Path

    @property
    def path(self) -> Path:
        """The file."""
        return self.directory / CONFIG

    @property
    def _checkpoints(self) -> Path:
        return self.directory / "checkpoints"

    def write(
        self,
        groups: list[Group],
        preset: str,
        device: str,
        shard: Shard | None = None,
        origin: str | None = None,
        command: Sequence[str] = (),
    ) -> None:
        """Record how to run the sweep again.

        Args:
            groups: what is trained.
            preset: with which it began.
            device: what JAX computes on.
            shard: of which sweep the groups are a part, if they are one.
            origin: what it starts from, of which start.npz has the arrays; None for from scratch.
            command: that began it; empty if none did.

        Raises:
            SettingError: a run's name cannot be that of a file.
        """
        for group in groups:
            for run in group.runs:
                check_name(run.name)
        self.replace(
            {
                "format": FORMAT,
                "command": list(command),
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

    def replace(self, config: Mapping[str, Any]) -> None:
        """Make this the config.

        Raises:
            OSError: it cannot be written.
        """
        with replacing(self.path, durable=True) as file:
            file.write((json.dumps(config, indent=2) + "\n").encode())

    def read_bytes(self) -> bytes:
        """What config.json holds; nothing if it cannot be read."""
        try:
            return self.path.read_bytes()
        except OSError:
            return b""

    def restore(self) -> str | None:
        """Bring a lost or torn config.json back from a checkpoint; return a line if that was done.

        Raises:
            SettingError: a part of the directory leads elsewhere.
            ReadError: it, or a checkpoint, cannot be read just now.
            OSError: it cannot be written.
        """
        check_parts(self.directory)
        if not os.path.isdir(self.directory):  # noqa: PTH112 -- nor a name that is too long
            return None
        return restore_config(self.path, self._checkpoints)

    def read(self) -> dict[str, Any]:
        """What config.json says, in the present format, unchecked but for its outline.

        Raises:
            SettingError: it is damaged, or of a newer version.
        """
        try:
            config = upgraded(self._read())
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
            entry = self._read().get("shard")
            if entry is None:
                return None
            shard = Shard(**{**entry, "swept": tuple(entry["swept"])})
            numbers, texts = (shard.part, shard.parts), (shard.sweep, *shard.swept)
            whole = {type(number) for number in numbers} == {int}
            if not whole or not 1 <= shard.part <= shard.parts <= MAX_PARTS:
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
            config = renamed(upgraded(self._read()), moved or {})
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
                recorded = recorded_names(upgraded(self._read()), kind)
            except UNREADABLE as error:
                raise self._damaged(error) from None
            asked = {absolute(text) for text in texts}
            gone = [text for text in recorded if is_own(text) and text not in asked]
            for text in sorted(asked - {*recorded}):
                before = [old for old in gone if attribute_of(old) == attribute_of(text)]
                if not is_own(text) or len(before) != 1 or before[0] in moved:
                    there = f"{self.directory} was trained with {', '.join(recorded) or 'none'}"
                    raise SettingError(f"{kind}: {there}, not {text}")
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
            return changes(self._read(), provenance(device, own_names(groups)), moved)
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
            config = self._read()
            files = config.get("files", {})
            entry = {"time": _now(), "changed": list(changed)}
            if epochs is not None:
                config = upgraded(config)
                for values in (values for group in config["groups"] for values in group["runs"]):
                    values["epochs"] = epochs
            config |= {
                "groups": renamed(config["groups"], moved),
                "files": {str(moved_path(name, moved)): files[name] for name in files},
                "hosted": moved_hosts(config.get("hosted", {}), moved),
                "resumed": [*config.get("resumed", []), entry],
            }
        except UNREADABLE as error:
            raise self._damaged(error) from None
        self.replace(config)

    def _read(self) -> Any:
        return read_config(self.path)

    def _damaged(self, error: Exception) -> SettingError:
        complaint = damaged(self.path, error)
        if not holds_config(self._checkpoints):
            return complaint
        return SettingError(f"{complaint}; without this file it comes back from a checkpoint")


def _now() -> str:
    return datetime.now(UTC).isoformat(timespec="seconds")
