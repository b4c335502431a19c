"""The command-line programs: their arguments, and what ends them.

Bad input ends with one line and exit code 2: a bad value before a device is touched, a bad
environment or directory before anything compiles.
"""

import contextlib
import io
import re
import sys
from collections import Counter
from collections.abc import Callable, Sequence
from contextvars import ContextVar
from pathlib import Path
from typing import NoReturn, TypeVar

import tyro

from cgm_jax.config.fields import SettingError
from cgm_jax.host.exit_codes import ExitCode
from cgm_jax.host.help_texts import with_paragraphs
from cgm_jax.host.setting_options import asks_for_help, in_groups, show_preset
from cgm_jax.host.streams import make_streams_harmless
from cgm_jax.host.training_options import TrainingOptions
from cgm_jax.storage.files import ReadError, refusal
from cgm_jax.storage.lock import InUseError
from cgm_jax.storage.run_directory import RunDirectory
from cgm_jax.storage.untrusted import printable

MAX_MESSAGE = 2000
_OWNS_PROCESS = ContextVar("owns_process", default=False)
_REPEATED: ContextVar[Sequence[str]] = ContextVar("repeated", default=())

Options = TypeVar("Options")


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
    if asks_for_help(words):
        if issubclass(kind, TrainingOptions):
            show_preset(words, kind.default_preset, single=not kind.sweeps)
            kind = in_groups(kind)
        kind = with_paragraphs(kind)
    complaint = io.StringIO()
    try:
        with contextlib.redirect_stderr(complaint):
            options = tyro.cli(
                kind, args=arguments, prog=program, config=(tyro.conf.FlagCreatePairsOff,)
            )
    except SystemExit as end:
        if end.code == ExitCode.BAD_INPUT:
            box = complaint.getvalue()
            refuse("; perhaps ".join([_first_paragraph(box), *_meant(box)]))
        raise
    _REPEATED.set(_given_twice(words))
    if not issubclass(kind, TrainingOptions):
        remark_on_repeated()
    return options


def remark_on_repeated() -> None:
    """Say which options were given twice: of training, once nothing of it is refused any more."""
    for option in _REPEATED.get():
        print(f"{option} is given twice: only the last counts", file=sys.stderr)
    _REPEATED.set(())


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
    except ReadError as error:
        refuse(refusal(error, Path()), ExitCode.CANNOT_WRITE)
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
    """End with one line, as `print_error` has it, and an exit code."""
    print_error(message)
    sys.exit(code)


def print_error(message: object) -> None:
    """Say what is wrong in one line; the middle of a very long one is left out."""
    line, half = printable(" ".join(str(message).split())), MAX_MESSAGE // 2
    shown = line if len(line) <= MAX_MESSAGE else f"{line[:half]}...{line[-half:]}"
    print(f"error: {shown}", file=sys.stderr)


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
