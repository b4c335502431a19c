"""Errors from below JAX, in one line."""

import contextlib
import re
from collections.abc import Iterator


class DeviceError(RuntimeError):
    """A compiled program has failed; the message says what it met and where."""


@contextlib.contextmanager
def device_errors() -> Iterator[None]:
    """Turn whatever a compiled program raises into a `DeviceError`.

    JAX raises several types, and hands on an error in a host callback, such as MuJoCo's, as the
    text of a whole traceback.

    Raises:
        DeviceError: the block has failed.
    """
    try:
        yield
    except Exception as error:
        _wait_for_others()
        raise DeviceError(summary(f"{type(error).__name__}: {error}")) from error


def _wait_for_others() -> None:
    """Wait for other devices, and forget what failed: at exit JAX would print it all again."""
    with contextlib.suppress(ImportError, AttributeError):  # JAX has no public way
        from jax._src.dispatch import runtime_tokens

        for token in runtime_tokens.output_runtime_tokens.values():
            with contextlib.suppress(Exception):
                token.block_until_ready()
        runtime_tokens.clear()


def summary(text: str) -> str:
    """The error at the end of a traceback and its place, or the first line of other texts."""
    lines = text.splitlines()
    places = [i for i, line in enumerate(lines) if re.match(r'\s*File ".*", line \d+', line)]
    if not places:
        return lines[0]
    place = lines[places[-1]].strip()
    # Source code is indented; a message may have several lines, of which the first must do.
    rest = [line for line in lines[places[-1] + 1 :] if line.strip() and not line.startswith(" ")]
    return f"{rest[0] if rest else lines[0]} ({place})"
