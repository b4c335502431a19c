"""From lists of values to runs, and from runs to groups that one program trains.

Every setting may be swept. Runs that differ only in traced settings share one compiled program;
each combination of static ones (batch size, layers, curriculum, agent, environment, ...) has a
program of its own, and they run one after another.
"""

import dataclasses
import itertools
import math
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import jax

from cgm_jax.config.components import DEFAULTS, NAMES, ROOMS, component, owners
from cgm_jax.config.fields import Field, SettingError, check, check_value, declared, parts, stack
from cgm_jax.config.named import absolute
from cgm_jax.config.presets import Grid, preset_grid
from cgm_jax.config.run_names import run_name
from cgm_jax.config.settings import LOOP_FIELDS, RESERVED, Hyperparameters, Settings

MAX_RUNS = 100_000

STATIC = [item.name for item in dataclasses.fields(Settings)]
TRACED = [item.name for item in declared(Hyperparameters)]

Values = dict[str, Any]
"""One run: the value of every setting that it has, by name, components by theirs."""


@dataclass(frozen=True)
class Run:
    """One training run of a sweep.

    Attributes:
        name: tells it from the others; also a file name.
        hyper: its settings.
        values: the same by name, with those that its group shares.
    """

    name: str
    hyper: Hyperparameters
    values: Values = dataclasses.field(compare=False, hash=False)


@dataclass(frozen=True)
class Group:
    """Runs that one program trains side by side."""

    settings: Settings
    runs: tuple[Run, ...]

    def hyper(self) -> Hyperparameters:
        """Settings of all runs, every leaf [runs]."""
        return stack([run.hyper for run in self.runs])


def build_groups(preset: str, options: Grid, *, single: bool = False) -> list[Group]:
    """All runs of a sweep, one group per compiled program.

    Args:
        preset: a name in `presets.PRESETS`.
        options: lists of values that replace the preset's.
        single: of the preset's lists take the first value only.

    Raises:
        SettingError: an empty list, a value out of range, the same value twice, an option that no
            chosen component has, or runs that would share a name.
    """
    runs: list[tuple[Settings, Run]] = []
    most = 1 if single else None
    ours = {name: values[:most] for name, values in preset_grid(preset).items()}
    for env in _axis({**ours, **options}, LOOP_FIELDS["env"]):
        ours = {name: values[:most] for name, values in preset_grid(preset, env).items()}
        grid = {**ours, **options, "env": [env]}
        runs += [_settings_and_run(values, _swept(grid, values)) for values in _combinations(grid)]
    _check_used(options, [run.values for _, run in runs])
    return _grouped(runs)


def groups_again(runs: Mapping[str, Values], options: Grid) -> list[Group]:
    """Runs of an earlier sweep again, with other values for some of their settings.

    Args:
        runs: all values of each run, by its name.
        options: lists of values that replace those of every run. Without any, the groups are as
            they were before a lack of memory split them.

    Raises:
        SettingError: as `build_groups`.
    """
    if not options:
        return _grouped([run_of(name, values) for name, values in runs.items()])
    varied: dict[Hashable, Values] = {}
    for own in runs.values():
        own = {name: [value] for name, value in own.items()}
        for values in _combinations({**own, **options}):
            varied.setdefault(_what_counts(values), values)
    found = list(varied.values())
    _check_used(options, found)
    named = {name for name in NAMES if len({values[name] for values in found}) > 1}
    alike = {key: _differing(own) for key, own in _by_components(found).items()}
    return _grouped(
        [
            _settings_and_run(values, [n for n in values if n in alike[key] or n in named])
            for key, own in _by_components(found).items()
            for values in own
        ]
    )


def _by_components(runs: Sequence[Values]) -> dict[Hashable, list[Values]]:
    """Runs by their environment and components: those of a list have the same settings."""
    alike: dict[Hashable, list[Values]] = {}
    for values in runs:
        alike.setdefault(tuple(values[name] for name in NAMES), []).append(values)
    return alike


def _differing(runs: Sequence[Values]) -> set[str]:
    """Settings in which runs of the same components differ."""
    return {name for name in runs[0] if len({repr(values[name]) for values in runs}) > 1}


def hyperparameters(**values: Any) -> Hyperparameters:
    """Settings of one run from values by name, of the loop and of its components alike.

    What is not given has its default, or what the curriculum wants.

    Raises:
        SettingError: no component has such a setting, a value is out of its range, or a component
            has a setting whose name is taken.
    """
    made = {}
    names = {kind: values.pop(kind, name) for kind, name in DEFAULTS.items()}
    classes = _classes(names)
    values = {**_wanted(classes), **values}
    for kind, found in classes.items():
        own = {item.name for item in declared(found)}
        made[kind] = found(**{name: values[name] for name in own & set(values)})
    taken = {item.name for part in made.values() for item in declared(part)}
    rest = {name: value for name, value in values.items() if name not in taken}
    if unknown := set(rest) - set(TRACED):
        raise SettingError(f"{min(unknown)}: nothing that was chosen has this setting")
    hyper = Hyperparameters(**rest, **made)
    check(hyper)
    return hyper


def values_of(settings: Settings, hyper: Hyperparameters, components: Mapping[str, str]) -> Values:
    """All values of a run by name; the inverse of `run_of`.

    Args:
        settings: static settings of the loop.
        hyper: of the run.
        components: names of its curriculum, agent and relabelling.
    """
    values = {name: getattr(settings, name) for name in STATIC}
    values |= {name: getattr(hyper, name) for name in TRACED}
    for kind, part in zip(DEFAULTS, parts(hyper), strict=True):
        values[kind] = components[kind]
        values |= {item.name: getattr(part, item.name) for item in declared(part)}
    return values


def defaults_of(components: Mapping[str, str]) -> Values:
    """All values of a run that chooses its components and nothing else.

    Args:
        components: names of its curriculum, agent and relabelling.
    """
    return values_of(Settings(), hyperparameters(**components), components)


def run_of(name: str, values: Values) -> tuple[Settings, Run]:
    """A run from all its values.

    Raises:
        SettingError: a value out of its range, or of no setting.
    """
    settings = Settings(**{key: values[key] for key in STATIC if key in values})
    rest = {key: value for key, value in values.items() if key not in STATIC}
    hyper = hyperparameters(**rest)
    chosen = {kind: values.get(kind, default) for kind, default in DEFAULTS.items()}
    return settings, Run(name, hyper, values_of(settings, hyper, chosen))


def structure(settings: Settings, hyper: Hyperparameters) -> tuple[Settings, Any]:
    """What runs of one program have in common."""
    return settings, jax.tree.structure(hyper)


def split(group: Group, largest: int) -> list[Group]:
    """Cut a group into groups of at most `largest` runs, as equal as can be."""
    count = -(-len(group.runs) // largest)
    size, longer = divmod(len(group.runs), count)
    sizes = [size + 1] * longer + [size] * (count - longer)
    ends = list(itertools.accumulate(sizes))
    return [
        Group(group.settings, group.runs[end - size : end])
        for size, end in zip(sizes, ends, strict=True)
    ]


def swept_settings(groups: Sequence[Group]) -> list[str]:
    """Names of the settings in which runs of a sweep differ, the seed aside."""
    runs = [run.values for group in groups for run in group.runs]
    names = dict.fromkeys(name for values in runs for name in values if name != "seed")
    return [
        name for name in names if len({repr(values[name]) for values in runs if name in values}) > 1
    ]


def _grouped(runs: Sequence[tuple[Settings, Run]]) -> list[Group]:
    """Runs by program, in order of first appearance.

    Raises:
        SettingError: two of them have the same name.
    """
    named: dict[str, Run] = {}
    for _, run in runs:
        other = named.setdefault(run.name, run)
        if other is not run:
            values = {name: (other.values.get(name), run.values[name]) for name in run.values}
            name = next(name for name in (*NAMES, *values) if len(set(map(repr, values[name]))) > 1)
            one, another = values[name]
            raise SettingError(f"{name}: {one} and {another} would give their runs the same names")
    groups: dict[Any, list[Run]] = {}
    for settings, run in runs:
        groups.setdefault(structure(settings, run.hyper), []).append(run)
    return [Group(settings, tuple(same)) for (settings, _), same in groups.items()]


def _check_used(options: Grid, runs: Sequence[Values]) -> None:
    """Check that every option is a setting of at least one run.

    Raises:
        SettingError: one is not; the message says what was chosen, and what has such a setting.
    """
    used = {name for values in runs for name in values}
    for name in options:
        if name not in used:
            chosen = {kind: dict.fromkeys(values[kind] for values in runs) for kind in ROOMS}
            text = ", ".join(f"{kind} {' or '.join(names)}" for kind, names in chosen.items())
            having = " or ".join(f"{kind} {owner}" for kind, owner in owners().get(name, []))
            hint = f"; it is one of {having}" if having else ""
            raise SettingError(f"{name}: is no setting of {text}{hint}")


def _combinations(grid: Grid) -> list[Values]:
    """The product of all axes, less runs that differ only in what has no effect."""
    runs: dict[Any, Values] = {}
    for chosen in itertools.product(*(_names(grid, kind) for kind in ROOMS)):
        components = dict(zip(ROOMS, map(absolute, chosen), strict=True))
        classes = _classes(components)
        fields = dict(LOOP_FIELDS)
        for found in classes.values():
            fields |= {item.name: item for item in declared(found)}
        wanted = {name: [value] for name, value in _wanted(classes).items()}
        axes = {name: _axis({**wanted, **grid}, item) for name, item in fields.items()}
        if math.prod(len(axis) for axis in axes.values()) > MAX_RUNS:
            longest = max(axes, key=lambda name: len(axes[name]))
            raise SettingError(f"{longest}: more than {MAX_RUNS:,} runs in one sweep")
        for combination in itertools.product(*axes.values()):
            values = {**dict(zip(axes, combination, strict=True)), **components}
            values["env"] = absolute(values["env"])
            runs.setdefault(_what_counts(values), values)
    if len(runs) > MAX_RUNS:
        raise SettingError(f"curriculum: more than {MAX_RUNS:,} runs in one sweep")
    return list(runs.values())


def _classes(names: Mapping[str, str]) -> dict[str, Any]:
    """The components of a run, by kind, from their names.

    Raises:
        SettingError: there is none of a name, or it has a setting whose own name is taken.
    """
    classes = {kind: component(kind, name) for kind, name in names.items()}
    known: dict[str, tuple[str, Field[Any]]] = {}
    for kind, found in classes.items():
        for item in declared(found):
            other, there = known.setdefault(item.name, (names[kind], item))
            if there.metadata != item.metadata:
                raise SettingError(
                    f"{kind}: {names[kind]} and {other} both have a setting called {item.name}, "
                    "but do not mean the same by it; rename it, or declare it by shared()"
                )
        if taken := sorted(RESERVED & {item.name for item in declared(found)}):
            raise SettingError(
                f"{kind}: {names[kind]} has a setting called {taken[0]}, a name that is taken"
            )
    return classes


def _what_counts(values: Values) -> Hashable:
    """What a run depends on: all values that have an effect."""
    idle = _idle(values)
    return tuple(sorted((name, repr(value)) for name, value in values.items() if name not in idle))


def _idle(values: Values) -> frozenset[str]:
    """Settings without effect on a run."""
    hyper = hyperparameters(**{k: v for k, v in values.items() if k not in STATIC})
    return idle_settings(hyper)


def idle_settings(hyper: Hyperparameters) -> frozenset[str]:
    """Names of settings without effect on a run with these hyperparameters."""
    noise = frozenset({"action_noise"}) if hyper.agent.explores else frozenset()
    return noise.union(*(part.idle() for part in parts(hyper)))


def _wanted(classes: Mapping[str, Any]) -> Values:
    """What a curriculum wants of its agent, where that can give it and has less by default."""
    wanted = classes["curriculum"].wants_critics
    fields = {item.name: item for item in declared(classes["agent"])}
    if "critics" not in fields or fields["critics"].default >= wanted:
        return {}
    return {"critics": wanted}


def _axis(grid: Grid, item: "Field[Any]") -> Sequence[Any]:
    """The values of one setting.

    Raises:
        SettingError: none, one out of its range, or one twice.
    """
    values = _several(item.name, grid.get(item.name, [item.default]))
    for value in values:
        check_value(item, value)
    return _distinct(item.name, values)


def _names(grid: Grid, kind: str) -> Sequence[str]:
    """The names of components of one kind.

    Raises:
        SettingError: none, one that does not exist, or one twice.
    """
    names = _several(kind, grid.get(kind, [DEFAULTS[kind]]))
    for name in names:
        component(kind, name)
    return _distinct(kind, names)


def _several(name: str, values: Any) -> Sequence[Any]:
    if not isinstance(values, list | tuple) or not values:
        raise SettingError(f"{name}: needs at least one value")
    return values


def _distinct(name: str, values: Sequence[Any]) -> Sequence[Any]:
    if len({absolute(one) if isinstance(one, str) else one for one in values}) < len(values):
        raise SettingError(f"{name}: holds a value twice")
    return values


def _settings_and_run(values: Values, swept: Sequence[str]) -> tuple[Settings, Run]:
    return run_of(run_name(values, swept, _idle(values)), values)


def _swept(grid: Grid, values: Values) -> list[str]:
    """Settings of a run that take several values in its grid."""
    return [name for name in values if len(grid.get(name, ())) > 1]
