"""Options of the command-line programs, made from the declarations of settings.

Every setting is an option that takes one or more values. Bad input ends with one line and exit
code 2: a bad value before a device is touched, a bad environment or directory before anything
compiles.
"""

import contextlib
import dataclasses
import io
import math
import re
import sys
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from contextvars import ContextVar
from pathlib import Path
from typing import Annotated, Any, ClassVar, NoReturn, TypeVar

import tyro

from cgm_jax.config.components import NAMES, TRACK, builtin, builtin_fields, own_fields
from cgm_jax.config.fields import SettingError
from cgm_jax.config.named import is_own, name_now
from cgm_jax.config.presets import PRESETS, Grid
from cgm_jax.config.settings import LOOP_FIELDS
from cgm_jax.config.spelling import value_of
from cgm_jax.host.devices import ALL, parse_devices
from cgm_jax.host.exit_codes import ExitCode
from cgm_jax.host.help_texts import with_paragraphs
from cgm_jax.host.setting_options import (
    SettingOptions,
    asks_for_help,
    given_settings,
    in_groups,
    show_preset,
)
from cgm_jax.host.streams import make_streams_harmless
from cgm_jax.machine.device_errors import DeviceError
from cgm_jax.storage.files import refusal
from cgm_jax.storage.lock import InUseError
from cgm_jax.storage.run_directory import RunDirectory

DEFAULT_CHECKPOINT_SECONDS = 300.0
"""A checkpoint of a large sweep is gigabytes; this loses at most five minutes."""

MAX_MESSAGE = 2000
_OWNS_PROCESS = ContextVar("owns_process", default=False)

Options = TypeVar("Options")


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
    settings stay; but files of your own that have moved or were edited are named again, with --env
    and the like."""

    start: Annotated[
        Path | None, tyro.conf.arg(name="from", metavar="DIR|FILE.npz", help_behavior_hint="")
    ] = None
    """Start from what another run has learned: a run directory (agent and normaliser as they were
    at its last checkpoint) or a policy file (actor and normaliser). Shapes must agree."""

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
    """Devices that share the runs: a number, or all. Of a CPU that is one for each core
    given, and bits do not depend on how many."""

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


def parse(
    kind: type[Options],
    arguments: Sequence[str] | None,
    program: str,
    *,
    from_file: bool = False,
) -> Options:
    """Parse arguments; on bad ones end with one line and exit code 2.

    Args:
        kind: the options.
        arguments: what is given; None for the command line.
        program: its name, for --help.
        from_file: whether they stand in a file, and are not the user's now.

    Raises:
        SettingError: one is no option, but would have tyro do something else than parse.
    """
    words = sys.argv[1:] if arguments is None else arguments
    _check_words(words, from_file=from_file)
    for option in _given_twice(words):
        print(f"{option} is given twice: only the last counts", file=sys.stderr)
    if asks_for_help(words):
        if issubclass(kind, TrainingOptions):
            show_preset(words, kind.default_preset, single=not kind.sweeps)
            kind = in_groups(kind)
        kind = with_paragraphs(kind)
    complaint = io.StringIO()
    try:
        with contextlib.redirect_stderr(complaint):
            return tyro.cli(
                kind, args=arguments, prog=program, config=(tyro.conf.FlagCreatePairsOff,)
            )
    except SystemExit as end:
        if end.code == ExitCode.BAD_INPUT:
            box = complaint.getvalue()
            refuse("; perhaps ".join([_first_paragraph(box), *_meant(box)]))
        raise


def _check_words(words: Sequence[str], *, from_file: bool) -> None:
    """Check that words do nothing but choose options.

    Tyro has options of its own, which write a completion script to whatever path they are given,
    and end the process. So does --help, which a file has no business to ask for. "None" it takes
    for an option that is not given.

    Raises:
        SettingError: one does more, or is not what it seems.
    """
    for word in words:
        option = word.partition("=")[0]
        if option.replace("_", "-").startswith("--tyro-") or (from_file and asks_for_help([word])):
            raise SettingError(f"{word[:60]!r} is no option here")
        if word == "None" or (option.startswith("--") and word.endswith("=None")):
            raise SettingError("None is no value here; leave the option out, or --set NAME=None")


def _given_twice(words: Sequence[str]) -> list[str]:
    """Options of which only what is given last counts, as they are called."""
    options = [word.partition("=")[0].replace("_", "-") for word in words]
    counts = Counter(option for option in options if option.startswith("--") and option != "--")
    return [option for option, count in counts.items() if count > 1]


def run_program(main: Callable[[], int]) -> NoReturn:
    """Run a program's body and exit with its code; what is refused, or fails, is one line."""
    make_streams_harmless()
    _OWNS_PROCESS.set(True)
    try:
        sys.exit(main())
    except SettingError as error:
        refuse(str(error))
    except InUseError as error:
        refuse(str(error), ExitCode.IN_USE)
    except DeviceError as error:
        refuse(str(error), ExitCode.FAILED)
    except KeyboardInterrupt:
        sys.exit(ExitCode.STOPPED)


def print_restored(directory: Path) -> None:
    """Do as `bring_config_back`, for a program that only reads what a sweep has written.

    Raises:
        SettingError: it cannot be read or written, or a part of the directory leads elsewhere.
    """
    try:
        bring_config_back(directory)
    except OSError as error:
        raise SettingError(refusal(error, directory)) from None


def bring_config_back(directory: Path) -> None:
    """Bring a run directory's lost or torn config.json back, if a checkpoint has it, and say so.

    Raises:
        SettingError: a part of the directory leads elsewhere.
        OSError: it cannot be read, which a `ReadError` says, or written.
    """
    if (line := RunDirectory(directory).config.restore()) is not None:
        print(line, file=sys.stderr)


def owns_process() -> bool:
    """Whether this process runs one of our programs, and not `main()` inside another one."""
    return _OWNS_PROCESS.get()


def refuse(message: str, code: ExitCode = ExitCode.BAD_INPUT) -> NoReturn:
    """End with one line and an exit code."""
    line = "".join(letter if letter.isprintable() else "?" for letter in " ".join(message.split()))
    shown = line if len(line) <= MAX_MESSAGE else f"{line[:MAX_MESSAGE]}..."
    print(f"error: {shown}", file=sys.stderr)
    sys.exit(code)


def _meant(box: str) -> list[str]:
    """What an option that does not exist may be meant to be, in one text, if tyro has an idea."""
    if "Unrecognized options" not in box:
        return []
    found = re.findall(r"^(?:│ )? +(--[a-z-]+)\b", box, re.MULTILINE)
    return [" or ".join(found)] if found else []


def _first_paragraph(box: str) -> str:
    """The message in what tyro says of an error: a title, the message, a rule, and advice.

    All of it in a box; where standard output is plain ASCII, with a rule below the title instead.
    """
    lines = [re.sub(r"^│(.*)│$", r"\1", line.strip()).strip() for line in box.split("\n")]
    below_title = 1 if box.startswith("╭") else 2
    message = []
    for line in lines[below_title:]:
        if line.startswith(("─", "╰", "---")):
            break
        message.append(line)
    text = " ".join(message).partition(" Got errors")[0].strip()
    text = re.sub(r"'None', |, 'None'", "", text)  # how tyro has options that may be left out
    return re.sub(
        r"no type matching .* could be instantiated from (.*?)\.?$", r"not understood: \1", text
    )
