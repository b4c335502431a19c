"""Settings as options: one each, absent by default, in groups by what has them.

Settings whose options are not given keep the preset's values. `--help` shows those of the preset
that is chosen on the same command line.
"""

import dataclasses
from collections.abc import Callable, Iterator, Sequence
from contextvars import ContextVar
from typing import Annotated, Any, Literal, NamedTuple, TypeVar

import tyro

from cgm_jax.config.components import DEFAULTS, ROOMS, builtin, builtin_fields, owners
from cgm_jax.config.fields import Field
from cgm_jax.config.presets import PRESETS, Grid, preset_grid
from cgm_jax.config.settings import LOOP_FIELDS
from cgm_jax.config.spelling import SWITCH, layers_of, spelled

ENVIRONMENT = ("env", "engine", "air_probability")
SPLITS = "splits programs"
Options = TypeVar("Options")
Switch = Literal["on", "off"]


class Shown(NamedTuple):
    """Whose values --help shows: of a preset, for the environments that are asked for."""

    preset: str = ""
    envs: tuple[str, ...] = ()
    single: bool = False


_shown: ContextVar[Shown] = ContextVar("shown", default=Shown())  # noqa: B039 -- immutable


def asks_for_help(words: Sequence[str]) -> bool:
    """Whether a command line asks for --help."""
    return not {"-h", "--help"}.isdisjoint(words)


def show_preset(words: Sequence[str], default: str, *, single: bool) -> None:
    """Have --help show the values of the preset that a command line chooses.

    Args:
        words: of the command line.
        default: the preset where none is chosen.
        single: whether a run takes the first of a preset's values only.
    """
    preset = next(iter(_words_after("--preset", words)), default)
    known = preset in PRESETS
    _shown.set(Shown(preset if known else "", tuple(_words_after("--env", words)), single))


def given_settings(options: Any) -> Grid:
    """The lists of values that were given, by setting."""
    fields = LOOP_FIELDS | builtin_fields()
    names = [item.name for item in dataclasses.fields(SettingOptions)]
    given = {name: getattr(options, name) for name in names}
    return {
        name: _read(fields.get(name), values)
        for name, values in given.items()
        if values is not None
    }


def in_groups(kind: type[Options]) -> type[Options]:
    """Options with those of settings in groups, as --help shows them.

    Parsing takes three times as long with groups, so that only --help has them.
    """
    hidden = [
        (item.name, tyro.conf.Suppress[Any], None) for item in dataclasses.fields(SettingOptions)
    ]
    groups = [_group(title, options) for title, options in _groups().items()]
    made = dataclasses.make_dataclass(
        kind.__name__, [*hidden, *groups], bases=(kind,), kw_only=True
    )
    made.__doc__ = kind.__doc__
    return made


def _read(item: "Field[Any] | None", values: Sequence[Any]) -> list[Any]:
    if item is not None and isinstance(item.default, tuple):
        return layers_of(item, values)
    if item is not None and isinstance(item.default, bool):
        return [SWITCH[value] for value in values]
    return list(values)


def _groups() -> dict[str, list[tuple[str, Any, Any]]]:
    """Options by the title of their group."""
    groups: dict[str, list[tuple[str, Any, Any]]] = {"environment": [], "loop": []}
    for item in LOOP_FIELDS.values():
        title = "environment" if item.name in ENVIRONMENT else "loop"
        groups[title].append(_option(item))
    fields, having = builtin_fields(), owners()
    for kind in ROOMS:
        groups[kind] = [_choice(kind)]
        for name, owned in having.items():
            if owned[0][0] == kind:
                groups.setdefault(_title(owned), []).append(_option(fields[name]))
    return groups


def _title(owned: Sequence[tuple[str, str]]) -> str:
    """Components as a title: "curriculum mega, agent ddpg, sac"."""
    names: dict[str, list[str]] = {}
    for kind, name in owned:
        names.setdefault(kind, []).append(name)
    return _listed([f"{kind} {_listed(own)}" for kind, own in names.items()])


def _group(title: str, options: Sequence[tuple[str, Any, Any]]) -> tuple[str, Any, Any]:
    """A group of options as a field, under the title that --help gives it."""
    name = "".join(letter if letter.isalnum() else "_" for letter in title)
    made = dataclasses.make_dataclass(name, options, kw_only=True)
    made.__doc__ = ""  # else it would be shown
    annotation = Annotated[made, tyro.conf.arg(name=title)]
    return f"{name}_settings", annotation, dataclasses.field(default_factory=made)


def _choice(kind: str) -> tuple[str, Any, Any]:
    names = ", ".join(sorted(builtin(kind)))
    appearance = tyro.conf.arg(
        help=f"{names}, or FILE.py:NAME of your own",
        metavar=_words("NAME"),
        help_behavior_hint=_hint(kind, f"default {DEFAULTS[kind]}", SPLITS),
        prefix_name=False,
    )
    return kind, Annotated[tuple[str, ...] | None, appearance], None


def _option(item: "Field[Any]") -> tuple[str, Any, Any]:
    """An option for a setting: in --help not as the optional list that it is internally."""
    kind = float if item.default is None else type(item.default)
    word = {bool: "on|off", tuple: "INT"}.get(kind, kind.__name__.upper())
    accepted = {bool: Switch, tuple: str}.get(kind, kind)
    split = "" if item.metadata["traced"] else SPLITS
    appearance = tyro.conf.arg(
        help=item.metadata["help"],
        metavar=_words(word),
        help_behavior_hint=_hint(item.name, _defaults(item), split),
        prefix_name=False,
    )
    return item.name, Annotated[tuple[accepted, ...] | None, appearance], None


def _words(word: str) -> str:
    """How --help writes one value, or as many as a sweep takes."""
    return word if _shown.get().single else f"{word} [{word} ...]"


def _defaults(item: "Field[Any]") -> str:
    """The default of a setting, or those of the components that have it, where they differ."""
    if item.name in LOOP_FIELDS:
        return "" if item.default is None else f"default {spelled(item.default)}"
    names: dict[str, list[str]] = {}
    for kind, owner in owners()[item.name]:
        default = builtin(kind)[owner].__dataclass_fields__[item.name].default
        names.setdefault(spelled(default), []).append(owner)
    if len(names) == 1:
        return f"default {next(iter(names))}"
    return f"default {'; '.join(f'{text} for {_listed(own)}' for text, own in names.items())}"


def _hint(name: str, default: str, split: str) -> Callable[[str], str]:
    """What --help adds to an option's help, once it is known which preset is chosen."""

    def hint(_: str) -> str:
        parts = [part for part in (default, _preset_values(name), split) if part]
        return f"({'; '.join(parts)})" if parts else ""

    return hint


def _preset_values(name: str) -> str:
    """The values that the shown preset gives a setting, by environment where they differ."""
    preset, envs, single = _shown.get()
    if not preset:
        return ""
    texts: dict[str, list[str]] = {}
    for env in envs or preset_grid(preset)["env"]:
        values = preset_grid(preset, env).get(name, [])
        texts.setdefault(" ".join(map(spelled, values[: 1 if single else None])), []).append(env)
    if set(texts) == {""}:
        return ""
    if len(texts) == 1:
        return f"{preset}: {next(iter(texts))}"
    each = (f"{text or 'default'} for {_listed(names)}" for text, names in texts.items())
    return f"{preset}: {'; '.join(each)}"


def _listed(names: Sequence[str]) -> str:
    return ", ".join(names)


def _words_after(option: str, words: Sequence[str]) -> Iterator[str]:
    """The values of an option on a command line, in either of its two spellings."""
    taking = False
    for word in words:
        if word.startswith("-"):
            taking = word == option
            if word.startswith(f"{option}="):
                yield word.partition("=")[2]
        elif taking:
            yield word


SettingOptions = dataclasses.make_dataclass(
    "SettingOptions", [option for options in _groups().values() for option in options], kw_only=True
)
"""Base of the programs' options: all settings, as lists."""
