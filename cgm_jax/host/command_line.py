"""Options of the command-line programs, made from the declarations of settings.

Every setting is an option that takes one or more values. Bad input ends with one line and exit
code 2: a bad value before a device is touched, a bad environment or directory before anything
compiles.
"""

import ast
import contextlib
import dataclasses
import io
import math
import re
import shlex
import sys
from collections.abc import Callable, Sequence
from contextvars import ContextVar
from pathlib import Path
from typing import Annotated, Any, Literal, NoReturn, TypeVar

import tyro

from cgm_jax.config.components import NAMES, ROOMS, builtin, builtin_fields
from cgm_jax.config.fields import SettingError
from cgm_jax.config.named import is_own, name_now
from cgm_jax.config.presets import PRESETS, Grid
from cgm_jax.config.settings import LOOP_FIELDS
from cgm_jax.host.devices import ALL, parse_devices
from cgm_jax.host.exit_codes import ExitCode
from cgm_jax.host.streams import make_streams_harmless
from cgm_jax.storage.lock import InUseError

DEFAULT_CHECKPOINT_SECONDS = 300.0
"""A checkpoint of a large sweep is gigabytes; this loses at most five minutes."""

MAX_MESSAGE = 2000
_OWNS_PROCESS = ContextVar("owns_process", default=False)

Options = TypeVar("Options")
Switch = Literal["on", "off"]
SWITCH = {"on": True, "off": False}


def _option_type(item: "dataclasses.Field[Any]") -> Any:
    if isinstance(item.default, bool):
        return tuple[Switch, ...] | None
    if item.name == "hidden_layers":
        return tuple[str, ...] | None
    kind = float if item.default is None else type(item.default)
    return tuple[kind, ...] | None


def _setting_options() -> list[tuple[str, Any, Any]]:
    """One option per setting, absent by default: then the preset decides."""
    choices = [
        (kind, Annotated[tuple[str, ...] | None, _choice_appearance(kind)], None) for kind in ROOMS
    ]
    items = (LOOP_FIELDS | builtin_fields()).values()
    options = [
        (item.name, Annotated[_option_type(item), _appearance(item)], None) for item in items
    ]
    return [*choices, *options]


def _choice_appearance(kind: str) -> Any:
    names = ", ".join(sorted(builtin(kind)))
    return tyro.conf.arg(
        help=f"{kind}: {names}, or FILE.py:NAME of your own",
        metavar="NAME [NAME ...]",
        help_behavior_hint="",
    )


def _appearance(item: "dataclasses.Field[Any]") -> Any:
    """How an option looks in --help: not as the optional list that it is internally."""
    kind = "on|off" if isinstance(item.default, bool) else type(item.default).__name__.upper()
    if item.default is None:
        kind = "FLOAT"
    if item.name == "hidden_layers":
        kind = "INT"
    default = "all settings default to the preset's" if item.name == "env" else ""
    return tyro.conf.arg(
        help=item.metadata["help"],
        metavar=f"{kind} [{kind} ...]",
        help_behavior_hint=f"({default})" if default else "",
    )


SettingOptions = dataclasses.make_dataclass("SettingOptions", _setting_options(), kw_only=True)
"""Base of the programs' options: all settings, as lists."""


@dataclasses.dataclass(kw_only=True)
class TrainingOptions(SettingOptions):
    """What sweep and train have in common besides the settings."""

    preset: Annotated[
        str, tyro.conf.arg(metavar=f"{{{','.join(PRESETS)}}}", help_behavior_hint="")
    ] = ""
    """Values to start from (default: quick for a sweep, cpu for one run)."""

    out: Path | None = None
    """Directory for the results (default: runs/PRESET-TIME)."""

    resume: Path | None = None
    """Directory of a sweep that was stopped: resume it. Takes no settings; but files of your
    own that have moved or were edited are named again, with --env and the like."""

    set: tuple[str, ...] = ()
    """Settings of a curriculum or agent of your own: NAME=VALUE, several values with commas."""

    checkpoint_seconds: float = DEFAULT_CHECKPOINT_SECONDS
    """Least time between checkpoints; has no effect on results."""

    devices: str = ALL
    """Devices that share the runs: a number or all. A CPU has one for each core that it was given.
    Network updates differ in the last bits between one device and several."""

    def resumes(self, chosen: Grid) -> bool:
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
        for name in ("out", "resume"):
            if getattr(self, name) == Path():
                raise SettingError(f"{name}: is empty")
        if self.preset and self.preset not in PRESETS:
            choices = ", ".join(PRESETS)
            raise SettingError(f"preset: unknown preset {self.preset!r}; choose from {choices}")
        if self.resume is None:
            return False
        # Own code may be named again: it has moved, or was edited.
        settings = [name for name in chosen if name not in NAMES]
        others = [*settings, *(name for name in ("preset", "out") if getattr(self, name))]
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


def chosen_values(options: Any) -> Grid:
    """The lists that the user gave, by setting; own code in them may run from now on."""
    grid: Grid = {}
    fields = LOOP_FIELDS | builtin_fields()
    switches = {name for name, item in fields.items() if isinstance(item.default, bool)}
    for item in dataclasses.fields(SettingOptions):
        values = getattr(options, item.name)
        if values is None:
            continue
        if item.name == "hidden_layers":
            grid[item.name] = _layers(values)
        elif item.name in switches:
            grid[item.name] = [SWITCH[value] for value in values]
        else:
            grid[item.name] = list(values)
    name_own_code(grid)
    return grid | dict(_own_setting(text) for text in options.set)


def _layers(words: Sequence[str]) -> list[tuple[int, ...]]:
    """Widths of hidden layers: 256 256 is one value, 64x64 128x128 are two.

    Raises:
        SettingError: a width is no whole number.
    """
    try:
        values = [tuple(int(width) for width in word.split("x")) for word in words]
    except ValueError:
        shown = " ".join(words)
        raise SettingError(
            f"hidden_layers: {shown!r} is neither widths (256 256) nor several (64x64 128x128)"
        ) from None
    if any("x" in word for word in words):
        return values
    return [tuple(width for value in values for width in value)]


def _own_setting(text: str) -> tuple[str, list[Any]]:
    """NAME=VALUE,VALUE as a name and values.

    Raises:
        SettingError: it is not of that form.
    """
    name, equals, values = text.partition("=")
    if not equals or not name.isidentifier():
        raise SettingError(f"set: {text!r} is not NAME=VALUE")
    return name, [_plain_value(value) for value in values.split(",")]


def _plain_value(text: str) -> Any:
    if text in SWITCH:
        return SWITCH[text]
    try:
        return ast.literal_eval(text)
    except (ValueError, SyntaxError, RecursionError, MemoryError):  # too deep
        return text


def seed_values(options: Any, grid: Grid) -> Grid:
    """Expand `--seeds N` to the seeds 0 to N - 1.

    Raises:
        SettingError: N is below 1, or `--seed` is given as well.
    """
    if options.seeds is None:
        return grid
    if "seed" in grid:
        raise SettingError("seeds: give either --seeds (how many) or --seed (which), not both")
    if not 1 <= options.seeds <= 10**6:
        raise SettingError(f"seeds: {options.seeds} is not within [1, 1000000]")
    return {**grid, "seed": list(range(options.seeds))}


def parse(kind: type[Options], arguments: Sequence[str] | None, program: str) -> Options:
    """Parse arguments; on bad ones end with one line and exit code 2."""
    complaint = io.StringIO()
    try:
        with contextlib.redirect_stderr(complaint):
            return tyro.cli(
                kind, args=arguments, prog=program, config=(tyro.conf.FlagCreatePairsOff,)
            )
    except SystemExit as end:
        if end.code == ExitCode.BAD_INPUT:
            refuse(_first_paragraph(complaint.getvalue()))
        raise


def run_program(main: Callable[[], int]) -> NoReturn:
    """Run a program's body and exit with its code, refusing bad settings with one line."""
    make_streams_harmless()
    _OWNS_PROCESS.set(True)
    try:
        sys.exit(main())
    except SettingError as error:
        refuse(str(error))
    except InUseError as error:
        refuse(str(error), ExitCode.IN_USE)
    except KeyboardInterrupt:
        sys.exit(ExitCode.STOPPED)


def owns_process() -> bool:
    """Whether this process runs one of our programs, and not `main()` inside another one."""
    return _OWNS_PROCESS.get()


def refuse(message: str, code: ExitCode = ExitCode.BAD_INPUT) -> NoReturn:
    """End with one line and an exit code."""
    line = "".join(letter if letter.isprintable() else "?" for letter in " ".join(message.split()))
    shown = line if len(line) <= MAX_MESSAGE else f"{line[:MAX_MESSAGE]}..."
    print(f"error: {shown}", file=sys.stderr)
    sys.exit(code)


def shell_command(program: str, *arguments: str | Path) -> str:
    """A command line that runs a program of this package as it is, from any directory.

    Paths become absolute, everything is quoted, and the interpreter is the one that runs now.
    """
    words = [Path(word).absolute() if isinstance(word, Path) else word for word in arguments]
    interpreter = sys.executable or "python"
    return shlex.join([interpreter, "-m", program, *(str(word) for word in words)])


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
    return re.sub(
        r"no type matching .* could be instantiated from (.*?)\.?$", r"not understood: \1", text
    )
