"""Texts of --help, one paragraph each, from the docstrings below the fields of options.

tyro takes these docstrings too, but keeps their line breaks, to which a terminal adds its own, and
shows options that may be left out as "{None}|PATH ... (default: None)".
"""

import ast
import dataclasses
import inspect
import itertools
import textwrap
from collections.abc import Iterator
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

import tyro

Options = TypeVar("Options")


def with_paragraphs(kind: type[Options]) -> type[Options]:
    """The same options, each with its text as one paragraph."""
    texts: dict[str, str] = {}
    for base in kind.__mro__:
        texts = {**dict(_texts(base)), **texts}
    hints = get_type_hints(kind, include_extras=True)
    fields = [
        (item.name, _told(hints[item.name], texts[item.name], item.default), _copy(item))
        for item in dataclasses.fields(kind)  # pyright: ignore[reportArgumentType]
        if item.name in texts
    ]
    made = dataclasses.make_dataclass(kind.__name__, fields, bases=(kind,), kw_only=True)
    made.__doc__ = kind.__doc__
    return made


def _texts(kind: type) -> Iterator[tuple[str, str]]:
    """Names of a class's own fields and what stands below them; none if it has no source."""
    try:
        (tree,) = ast.parse(textwrap.dedent(inspect.getsource(kind))).body
    except (OSError, TypeError):
        return
    for field, below in itertools.pairwise(getattr(tree, "body", [])):
        match field, below:
            case ast.AnnAssign(target=ast.Name(name)), ast.Expr(ast.Constant(str() as text)):
                yield name, " ".join(text.split())


def _told(hint: Any, text: str, default: Any) -> Any:
    """A type with a text, ahead of all else that it carries, which has priority."""
    kind, *others = get_args(hint) if get_origin(hint) is Annotated else (hint,)
    metavar = _metavar(kind) if default in (None, ()) else None
    if default is None and tyro.conf.Positional in others:
        metavar = f"[{metavar}]"
    # None leaves it to tyro, which says "(default: ...)".
    hint = "" if default in (None, (), False) or "(default" in text else None
    told = tyro.conf.arg(help=text, metavar=metavar, help_behavior_hint=hint)
    return Annotated[kind, told, *others]


def _metavar(kind: Any) -> str:
    """What stands for the value of an option that may be left out: STR, or STR [STR ...]."""
    optional = get_origin(kind) in (Union, UnionType)
    (given,) = [one for one in get_args(kind) if one is not NoneType] if optional else [kind]
    if get_origin(given) is Literal:
        return f"{{{','.join(get_args(given))}}}"
    if get_origin(given) is tuple:
        word = get_args(given)[0].__name__.upper()
        return f"{word} [{word} ...]"
    return given.__name__.upper()


def _copy(item: "dataclasses.Field[Any]") -> Any:
    return dataclasses.field(
        default=item.default, default_factory=item.default_factory, kw_only=True
    )
