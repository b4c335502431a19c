"""What other programs may import: listed in cgm_jax's docstring, and nowhere else."""

import ast
import importlib
import inspect
import re
import textwrap
from collections.abc import Iterator

import pytest

import cgm_jax
from tests.cgm_jax.sweeps import ROOT

Name = tuple[str, str]
"""Of a module, and of something in it."""


def imported(source: str) -> Iterator[Name]:
    """What the import statements of a program take from the package."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] == "cgm_jax":
            yield from ((node.module or "", alias.name) for alias in node.names)


def listed() -> list[Name]:
    lines = re.findall(r"^    from cgm_jax.*$", inspect.getdoc(cgm_jax) or "", re.MULTILINE)
    return list(imported(textwrap.dedent("\n".join(lines))))


PUBLIC = listed()
SHOWN = {
    **{path.name: path.read_text() for path in (ROOT / "tests/examples").glob("[!_t]*.py")},
    **{
        f"README, {place}": block
        for place, block in enumerate(
            re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(), re.DOTALL)
        )
    },
}


def test_the_list_is_in_order_and_without_what_is_private() -> None:
    assert len(PUBLIC) > 40
    assert [module for module, _ in PUBLIC] == sorted(module for module, _ in PUBLIC)
    assert len(set(PUBLIC)) == len(PUBLIC)
    assert not [name for _, name in PUBLIC if name.startswith("_")]


@pytest.mark.parametrize(("module", "name"), PUBLIC, ids=".".join)
def test_every_public_name_is_there_and_says_what_it_is(module: str, name: str) -> None:
    if module.endswith("stable_baselines3"):
        pytest.importorskip("stable_baselines3")
    found = getattr(importlib.import_module(module), name)
    if not (inspect.isclass(found) or inspect.isroutine(found)):
        assert found  # a constant, or a type's second name
        return
    said = found.__doc__ or ""
    assert len(said.split()) > 3
    assert not said.startswith(f"{name}(")  # a dataclass's own words
    methods = [each for key, each in vars(found).items() if key[0] != "_"] if "." in module else []
    assert not [each for each in methods if inspect.isfunction(each) and not each.__doc__]


@pytest.mark.parametrize("shown", sorted(SHOWN))
def test_what_users_are_shown_imports_nothing_else(shown: str) -> None:
    assert not set(imported(SHOWN[shown])) - set(PUBLIC)


def test_something_is_shown() -> None:
    names = {name for source in SHOWN.values() for name in imported(source)}
    assert {("cgm_jax.envs", "make"), ("cgm_jax.agents.protocol", "Agent")} <= names
