"""Values of settings as words, as options and names of runs have them, and back."""

from collections.abc import Sequence
from typing import Any

from cgm_jax.config.fields import Field, SettingError

SWITCH = {"on": True, "off": False}


def spelled(value: Any) -> str:
    """A value as one word: on, 64x64, 0.1."""
    if isinstance(value, bool):
        return "on" if value else "off"
    if isinstance(value, list | tuple):
        return "x".join(str(width) for width in value)
    return f"{value:.12g}" if isinstance(value, float) else str(value)


def counted(number: int, thing: str) -> str:
    """How many of a thing: 1 run, 2,000 runs."""
    return f"{number:,} {thing}{'' if number == 1 else 's'}"


def value_of(item: "Field[Any]", word: str) -> Any:
    """The value of a setting that a word spells, by the type of the setting's default.

    Raises:
        SettingError: it spells none.
    """
    if item.default is None and word == "None":
        return None
    kind = float if item.default is None else type(item.default)
    try:
        if kind is bool:
            return SWITCH[word]
        return _widths(word) if kind is tuple else kind(word)
    except (KeyError, ValueError):
        form = {bool: "on or off", tuple: "of a form such as 64x64"}
        raise SettingError(
            f"{item.name}: {word!r} is not {form.get(kind, f'of type {kind.__name__}')}"
        ) from None


def layers_of(item: "Field[Any]", words: Sequence[str]) -> list[tuple[int, ...]]:
    """Values of a setting that is several numbers: 256 256 is one value, 64x64 128x128 are two.

    Raises:
        SettingError: a width is no whole number.
    """
    try:
        values = [_widths(word) for word in words]
    except ValueError:
        shown = " ".join(words)
        raise SettingError(
            f"{item.name}: {shown!r} is neither widths (256 256) nor several (64x64 128x128)"
        ) from None
    if any("x" in word for word in words):
        return values
    return [tuple(width for value in values for width in value)]


def _widths(word: str) -> tuple[int, ...]:
    return tuple(int(width) for width in word.split("x"))
