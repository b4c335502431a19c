"""What sweep and train are asked for: their options, and the values of settings among them."""

import dataclasses
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, ClassVar

import tyro

from cgm_jax.config.components import NAMES, TRACK, builtin, builtin_fields, own_fields
from cgm_jax.config.fields import SettingError
from cgm_jax.config.named import is_own, name_now
from cgm_jax.config.presets import PRESETS, Grid
from cgm_jax.config.settings import LOOP_FIELDS
from cgm_jax.config.spelling import value_of
from cgm_jax.host.devices import ALL, parse_devices
from cgm_jax.host.setting_options import (
    SettingOptions,
    given_settings,
)

DEFAULT_CHECKPOINT_SECONDS = 300.0
"""A checkpoint of a large sweep is gigabytes; this loses at most five minutes."""


@dataclasses.dataclass(kw_only=True)
class TrainingOptions(SettingOptions):
    """What sweep and train have in common besides the settings.

    Attributes:
        default_preset: where none is given.
        sweeps: whether a setting takes several values.
    """

    default_preset: ClassVar[str]
    sweeps: ClassVar[bool]

    preset: Annotated[
        str, tyro.conf.arg(metavar=f"{{{','.join(PRESETS)}}}", help_behavior_hint="")
    ] = ""
    """Values to start from (default: quick for a sweep, cpu for one run)."""

    out: Annotated[Path | None, tyro.conf.arg(metavar="DIR", help_behavior_hint="")] = None
    """Directory for the results (default: runs/PRESET-TIME)."""

    resume: Annotated[Path | None, tyro.conf.arg(metavar="DIR", help_behavior_hint="")] = None
    """Directory of a sweep that was stopped, or is to be trained for more --epochs: resume it. Its
    settings stay. If files of your own have moved or were edited, name them again, with --env,
    --curriculum, --agent or --relabelling."""

    start: Annotated[
        Path | None, tyro.conf.arg(name="from", metavar="DIR|FILE.npz", help_behavior_hint="")
    ] = None
    """Start from what another run has learned: a run directory (agent and normaliser as they were
    at its last checkpoint) or a policy file (actor and normaliser). Shapes must agree, but
    that a policy file may lack inputs such as stages."""

    from_run: Annotated[str | None, tyro.conf.arg(metavar="NAME", help_behavior_hint="")] = None
    """Which run of --from DIR, if it has several."""

    dry_run: bool = False
    """Only say what would be trained, in which programs, and what it takes of memory and time, for
    which each program is compiled and run for some seconds. Makes no directory."""

    config: Annotated[
        Path | None, tyro.conf.arg(metavar="FILE.toml|FILE.json|DIR", help_behavior_hint="")
    ] = None
    """Settings from a file: a settings.toml, or the config.json of a run directory, which trains it
    again. What is given here comes before the file."""

    set: Annotated[
        tuple[str, ...],
        tyro.conf.arg(metavar="NAME=VALUE[,VALUE] ...", help_behavior_hint=""),
    ] = ()
    """Settings of a curriculum, agent or relabelling of your own; several numbers as 64x64."""

    csv: bool = False
    """Write metrics.csv, the rows of metrics.jsonl as a table, at the end, and whenever the
    directory is resumed; of a finished one with --resume DIR --csv."""

    checkpoint_seconds: float = DEFAULT_CHECKPOINT_SECONDS
    """Least time between checkpoints; has no effect on results."""

    devices: str = ALL
    """How many devices share the runs, or all. On a CPU all is one for each core that may be used;
    results have the same bits for any number."""

    track: Annotated[
        str | None,
        tyro.conf.arg(
            help=f"Show settings, metrics, figures and a video of the best policy in "
            f"{', '.join(sorted(builtin(TRACK)))}, or FILE.py:NAME of your own, too.",
            metavar="NAME",
            help_behavior_hint="",
        ),
    ] = None

    def resumes(self) -> bool:
        """Whether to resume a directory, whose settings are then already chosen.

        Raises:
            SettingError: options out of their range or in contradiction.
        """
        if not 0.0 <= self.checkpoint_seconds < math.inf:
            seconds = self.checkpoint_seconds
            raise SettingError(
                f"checkpoint_seconds: {seconds} is not a finite number of at least 0"
            )
        parse_devices(self.devices)
        for name in ("out", "resume", "config", "start"):
            if getattr(self, name) == Path():
                raise SettingError(f"{name.replace('start', 'from')}: is empty")
        if self.from_run is not None and self.start is None:
            raise SettingError("from_run: goes with --from DIR")
        if self.preset and self.preset not in PRESETS:
            choices = ", ".join(PRESETS)
            raise SettingError(f"preset: unknown preset {self.preset!r}; choose from {choices}")
        if self.resume is None:
            return False
        names = {"preset": "preset", "out": "out", "config": "config", "start": "from"}
        others = [shown for name, shown in names.items() if getattr(self, name)]
        if others:
            raise SettingError(
                f"resume: a sweep resumes as it was begun, without {', '.join(others)}"
            )
        return True


def name_own_code(grid: Grid) -> None:
    """What the user names on the command line may run."""
    for setting in NAMES:
        for text in grid.get(setting, ()):
            if is_own(text):
                name_now(text)


def chosen_values(
    options: Any,
    components: Mapping[str, Sequence[str]] | None = None,
    *,
    named_now: bool = True,
) -> Grid:
    """The lists that the user gave, by setting; own code in them may run from now on.

    Args:
        options: of sweep or train.
        components: what a file chooses where options do not, by kind.
        named_now: whether it is the user who gave them, and not a file of unknown origin.
    """
    grid = given_settings(options)
    if named_now:
        name_own_code(grid)
    values = _set_values(options.set, {**(components or {}), **grid})
    for name in values.keys() & grid.keys():
        raise SettingError(f"set: {name} is given as an option, too")
    return {**grid, **values}


def _set_values(texts: Sequence[str], chosen: Mapping[str, Sequence[str]]) -> Grid:
    """Values that `--set NAME=VALUE,VALUE` gives, read as the setting has them.

    Args:
        texts: what was given.
        chosen: components by kind, whose settings these may be.

    Raises:
        SettingError: a text is not of that form, a setting is given twice, or a value is not of
            its type.
    """
    fields = LOOP_FIELDS | builtin_fields() | own_fields(chosen)
    values: Grid = {}
    for text in texts:
        name, equals, words = text.partition("=")
        if not equals or not name.isidentifier():
            raise SettingError(f"set: {text!r} is not NAME=VALUE")
        if name in NAMES:  # which may name code to run
            raise SettingError(f"set: {name} is an option of its own, --{name}")
        if name in values:
            raise SettingError(f"set: {name} is given twice; several values are {name}=A,B")
        # What nothing has is refused together with options that nothing has.
        item = fields.get(name)
        values[name] = [value_of(item, word) if item else word for word in words.split(",")]
    return values


def seed_values(options: Any, grid: Grid) -> Grid:
    """Expand `--seeds N` to the seeds 0 to N - 1.

    Raises:
        SettingError: N is below 1, or `--seed` is given as well.
    """
    if getattr(options, "seeds", None) is None:
        return grid
    if "seed" in grid:
        raise SettingError("seeds: give either --seeds (how many) or --seed (which), not both")
    if not 1 <= options.seeds <= 10**6:
        raise SettingError(f"seeds: {options.seeds} is not within [1, 1000000]")
    return {**grid, "seed": list(range(options.seeds))}
