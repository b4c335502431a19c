"""How a setting is declared: at its field, with its default, help and range.

    @settings
    class CGM:
        c_g: float = traced(0.1, "success rate aimed at", 0, 1)
        history: int = static(10, "evaluation episodes behind success rates", 1, 10**6)

*Traced* settings enter the compiled program as numbers: one value per run, any number of runs in
one program. *Static* ones decide its structure: one program per value. An instance is a pytree
whose leaves are its traced settings, so that runs share a program exactly where the structures of
their settings agree.
"""

import dataclasses
import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import MISSING, dataclass, field
from numbers import Integral, Real
from typing import Any, TypeVar, dataclass_transform

import jax
import jax.numpy as jnp
import numpy as np
from jax.tree_util import GetAttrKey

Class = TypeVar("Class", bound=type)
Tree = TypeVar("Tree")
Field = dataclasses.Field

ACCEPTED = {str: str, bool: bool, int: Integral, float: Real, tuple: tuple}
"""What counts as a value of a setting, by the type of its default; numpy's numbers do."""

MAX_VALUES = 100
"""Of a setting that is several numbers."""

DTYPES = {int: np.int32, float: np.float32, bool: np.bool_}


class SettingError(ValueError):
    """A setting out of its range; the message starts with its name."""


def traced(default: Any, help: str, low: float = -math.inf, high: float = math.inf) -> Any:
    """A setting that enters the compiled program as a number."""
    return field(default=default, metadata=_metadata(True, help, low, high))


def static(default: Any, help: str, low: float = -math.inf, high: float = math.inf) -> Any:
    """A setting that decides the compiled program; None as default says that it may be absent."""
    return field(default=default, metadata=_metadata(False, help, low, high))


def shared(kind: type, name: str, default: Any = MISSING) -> Any:
    """A setting that another class declares too, so that both have one option.

    Args:
        kind: the other class.
        name: of the setting, there and here.
        default: the value here, if it is not the one there.
    """
    item = kind.__dataclass_fields__[name]  # pyright: ignore[reportAttributeAccessIssue]
    return field(default=item.default if default is MISSING else default, metadata=item.metadata)


def nested(make: Callable[[], Any]) -> Any:
    """A field that holds an instance of another class of settings, with settings of its own.

    Args:
        make: an instance, for one that is not given.
    """
    return field(default_factory=make, metadata={"nested": True})


def _metadata(traced: bool, help: str, low: float, high: float) -> dict[str, Any]:
    return {"traced": traced, "help": help, "low": low, "high": high}


@dataclass_transform(frozen_default=True, field_specifiers=(field,))
def settings(kind: Class) -> Class:
    """Make a class of settings: a frozen dataclass, and a pytree of its traced settings.

    Construction checks nothing, since JAX makes instances of tracers: call `check`.

    Raises:
        TypeError: a field is declared by none of the functions above, so that it would be no
            option, and neither recorded nor swept; or its default is of a type that no setting has.
    """
    kind = dataclass(frozen=True)(kind)
    for item in dataclasses.fields(kind):
        if not item.metadata.keys() & {"help", "nested"}:
            raise TypeError(
                f"{item.name} of {kind.__name__} is not a setting: declare it by "
                "traced(DEFAULT, HELP) or static(DEFAULT, HELP), or as a ClassVar"
            )
        _check_default(kind, item)
    static_names = [item.name for item in declared(kind) if not item.metadata["traced"]]
    names = [item.name for item in dataclasses.fields(kind) if item.name not in static_names]
    _register(kind, names, static_names)
    return kind


def _check_default(kind: type, item: "Field[Any]") -> None:
    """Check that a setting's default is of a type that settings have.

    Raises:
        TypeError: it is not.
    """
    if "help" not in item.metadata:
        return
    is_traced = item.metadata["traced"]
    if type(item.default) not in (DTYPES if is_traced else {*ACCEPTED, type(None)}):
        which = "a whole number, a number or a bool of Python's"
        which += "" if is_traced else ", a text, a tuple of whole numbers or None"
        how = "traced" if is_traced else "static"
        raise TypeError(
            f"{item.name} of {kind.__name__} has the default {item.default!r:.60}, but that of a "
            f"{how} setting is {which}"
        )


def _register(kind: type, names: Sequence[str], static_names: Sequence[str]) -> None:
    """Make a class a pytree of the fields `names`, whose structure are the others and the class.

    JAX's own registration of dataclasses takes the structures of two classes with as many fields
    for equal, and so now and then what it has traced of one curriculum for another.
    """

    def flatten(instance: Any) -> tuple[tuple[Any, ...], Any]:
        children = tuple((GetAttrKey(name), getattr(instance, name)) for name in names)
        return children, (kind, tuple(getattr(instance, name) for name in static_names))

    def unflatten(structure: Any, children: Iterable[Any]) -> Any:
        values = zip((*names, *static_names), (*children, *structure[1]), strict=True)
        return kind(**dict(values))

    jax.tree_util.register_pytree_with_keys(kind, flatten, unflatten)


def declared(kind: Any) -> list["Field[Any]"]:
    """The settings that a class (or an instance) declares itself, in order."""
    return [item for item in dataclasses.fields(kind) if "help" in item.metadata]


def check(instance: Any) -> None:
    """Check all values of an instance, and of the instances of settings in it.

    Raises:
        SettingError: a value of another type, not finite, or out of its range.
    """
    for item in declared(instance):
        check_value(item, getattr(instance, item.name))
    for part in parts(instance):
        check(part)


def check_concrete(instance: Any) -> None:
    """Check as `check` does all values but arrays, which may be traced.

    Raises:
        SettingError: as `check`.
    """
    for item in declared(instance):
        value = getattr(instance, item.name)
        if not isinstance(value, jax.Array | np.ndarray):
            check_value(item, value)
    for part in parts(instance):
        check_concrete(part)


def parts(instance: Any) -> Iterator[Any]:
    """Instances of settings that are fields of another."""
    for item in dataclasses.fields(instance):
        if "nested" in item.metadata:
            yield getattr(instance, item.name)


def check_value(item: "Field[Any]", value: Any) -> None:
    """Check one value of a setting.

    Raises:
        SettingError: it is of another type, not finite, or out of its range.
    """
    if value is None and item.default is None:
        return
    kind = float if item.default is None else type(item.default)
    if not isinstance(value, ACCEPTED[kind]) or isinstance(value, bool) != (kind is bool):
        raise SettingError(f"{item.name}: {value!r} is not of type {kind.__name__}")
    if kind is tuple:
        if not value:
            raise SettingError(f"{item.name}: needs at least one value")
        if len(value) > MAX_VALUES:
            raise SettingError(f"{item.name}: {len(value)} values are more than {MAX_VALUES}")
        if not all(isinstance(width, Integral) and not isinstance(width, bool) for width in value):
            raise SettingError(f"{item.name}: {value!r} holds something else than whole numbers")
    if kind not in (str, bool):
        for number in value if isinstance(value, tuple) else (value,):
            _check_range(item, number)


def _check_range(item: "Field[Any]", number: Any) -> None:
    low, high = item.metadata["low"], item.metadata["high"]
    if not -math.inf < number < math.inf:  # also of integers beyond any float
        raise SettingError(f"{item.name}: {number} is not a finite number")
    if not low <= number <= high:
        upper = "" if high == math.inf else f", {high:.10g}]"
        bounds = f"within [{low:.10g}{upper}" if upper else f"at least {low:.10g}"
        raise SettingError(f"{item.name}: {number} is not {bounds}")


def stack(runs: Sequence[Tree]) -> Tree:
    """Settings of several runs of one structure as one pytree, every leaf [runs].

    Types are fixed per field (int32, float32, bool), whatever the values, so that two grids of
    the same length compile to the same program.

    Raises:
        SettingError: a value of another type, not finite, or out of its range.
    """
    for run in runs:
        check(run)
    return jax.tree.map(lambda *leaves: jnp.asarray(np.stack(leaves)), *map(_typed, runs))


def _typed(instance: Any) -> Any:
    values: dict[str, Any] = {}
    for item in dataclasses.fields(instance):
        value = getattr(instance, item.name)
        if item.metadata.get("traced"):
            values[item.name] = np.asarray(value, DTYPES[type(item.default)])
        elif "nested" in item.metadata:
            values[item.name] = _typed(value)
    return dataclasses.replace(instance, **values)
