"""Settings from a file: a settings.toml of the user's, or the config.json of an earlier sweep.

    preset = "cpu"
    env = "push"
    seeds = 3                  # as the option --seeds
    c_g = [0.1, 0.4]           # several values make a grid axis
    hidden_layers = [128, 64]  # one value; [[64, 64], [128, 64]] are two

Both may come from anybody: code that they name runs only as config/named.py says.
"""

import sys
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from cgm_jax.config.components import NAMES
from cgm_jax.config.fields import Field, SettingError
from cgm_jax.config.named import is_own, require_named
from cgm_jax.config.presets import PRESETS, Grid
from cgm_jax.config.spelling import value_of
from cgm_jax.storage.config_file import read_groups, start_beside
from cgm_jax.storage.layout import CONFIG, check_parts

MAX_BYTES = 2**20
"""Of a settings.toml."""


class SettingsFile(NamedTuple):
    """What a file asks for.

    Attributes:
        preset: that a settings.toml chooses, or "".
        grid: lists of values by setting, of a settings.toml, as they stand there.
        runs: all values of each run, by its name, of a config.json.
        start: what the runs of a config.json started from; None for from scratch.
    """

    preset: str = ""
    grid: Grid = {}  # noqa: RUF012 -- of a NamedTuple, and never written to
    runs: Mapping[str, dict[str, Any]] | None = None
    start: Path | None = None

    def named(self, kind: str) -> list[Any]:
        """What the file has as its environments, or as its components of a kind."""
        if self.runs is None:
            return self.grid.get(kind, [])
        return list(dict.fromkeys(values[kind] for values in self.runs.values() if kind in values))

    def require_named(self, but: Mapping[str, Any]) -> None:
        """Check that own code that the file names may run, but for what options replace.

        Raises:
            SettingError: the user has not named it on this machine.
        """
        for kind in (kind for kind in NAMES if kind not in but):
            for text in self.named(kind):
                if is_own(text):
                    require_named(kind, text)


def read_settings_file(path: Path) -> SettingsFile:
    """Read settings; nothing that they name runs.

    Args:
        path: a .toml file, a .json file, or a run directory, whose config.json counts.

    Raises:
        SettingError: it cannot be read, holds something else than settings, or is in a directory
            of which a part leads elsewhere.
    """
    try:
        if path.is_dir():
            path = path / CONFIG
        if path.suffix == ".json":
            if path.name == CONFIG:  # of a run directory, which may come from anybody
                check_parts(path.parent)
            runs = {name: values for group in read_groups(path) for name, values in group.items()}
            return SettingsFile(runs=runs, start=start_beside(path))
        if path.stat().st_size > MAX_BYTES:
            raise ValueError(f"it has more than {MAX_BYTES:,} bytes")
        entries = tomllib.loads(path.read_text(encoding="utf-8"))
    except SettingError as error:
        raise SettingError(f"config: {error}") from None
    except OSError as error:
        raise SettingError(f"config: cannot read {path}: {error.strerror}") from None
    except (ValueError, RecursionError) as error:
        raise SettingError(f"config: {path} is no TOML: {error}") from None
    return _settings(path, entries)


def typed(grid: Grid, fields: Mapping[str, "Field[Any]"]) -> Grid:
    """The lists of a settings.toml, as their settings have them.

    Args:
        grid: as it stands in the file.
        fields: of all settings that may be in it, by name.

    Raises:
        SettingError: a text is no value of its setting.
    """
    return {
        name: [_typed(fields[name], value) for value in _several(fields[name], values)]
        if name in fields
        else values
        for name, values in grid.items()
    }


def _settings(path: Path, entries: Mapping[str, Any]) -> SettingsFile:
    grid: Grid = {}
    preset = entries.get("preset", "")
    if preset and (not isinstance(preset, str) or preset not in PRESETS):
        choices = ", ".join(PRESETS)
        raise SettingError(f"preset: unknown preset {preset!r} in {path}; choose from {choices}")
    for key, value in entries.items():
        name = key.replace("-", "_")
        if isinstance(value, dict):
            raise SettingError(f"config: {path} has a table {key!r}; settings stand side by side")
        if name in grid:
            raise SettingError(f"config: {path} holds {name} twice")
        if name != "preset":
            grid[name] = list(value) if isinstance(value, list) else [value]
    _check_names(path, grid)
    if "seeds" in grid:
        if "seed" in grid:
            raise SettingError(f"seeds: {path} holds seed as well")
        grid["seed"] = list(range(_seeds(path, grid.pop("seeds"))))
    return SettingsFile(preset, grid)


def _check_names(path: Path, grid: Grid) -> None:
    """Check that what a file names is text, before anything is looked up by it.

    Raises:
        SettingError: it is not.
    """
    for kind in NAMES:
        for value in grid.get(kind, ()):
            if not isinstance(value, str):
                raise SettingError(f"{kind}: {value!r:.40} in {path} is not of type str")


def _seeds(path: Path, counts: Sequence[Any]) -> int:
    """How many seeds a file asks for.

    Raises:
        SettingError: it is not one number, or out of its range.
    """
    if len(counts) != 1:
        said = f"{path} gives {len(counts)} values, not how many seeds"
        raise SettingError(f"seeds: {said}; seed = [...] says which")
    (count,) = counts
    if type(count) is not int or not 1 <= count <= 10**6:
        raise SettingError(f"seeds: {count!r} in {path} is no number within [1, 1000000]")
    return count


def _several(item: "Field[Any]", values: Sequence[Any]) -> Sequence[Any]:
    """Values of a setting; of one that is several numbers a list of numbers is one value."""
    is_one = isinstance(item.default, tuple) and all(isinstance(x, int) for x in values)
    return [list(values)] if is_one else values


def _typed(item: "Field[Any]", value: Any) -> Any:
    """A value of TOML as one of its setting; what is not, its check will refuse."""
    if isinstance(value, list):
        return tuple(value)
    if isinstance(value, str) and not isinstance(item.default, str):
        return value_of(item, value)
    is_real = item.default is None or isinstance(item.default, float)
    fits = type(value) is int and abs(value) <= sys.float_info.max
    return float(value) if is_real and fits else value
