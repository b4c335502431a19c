"""A folder's docstring is its map: it names every file, and no other."""

import ast
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
FOLDERS = sorted(
    path.parent
    for room in ("cgm_jax", "envs", "experiments")
    for path in (ROOT / room).rglob("__init__.py")
    if not path.is_relative_to(ROOT / "cgm_jax" / "envs")  # a link to envs
)


def docstring(folder: Path) -> str:
    return ast.get_docstring(ast.parse((folder / "__init__.py").read_text())) or ""


@pytest.mark.parametrize("folder", FOLDERS, ids=lambda folder: str(folder.relative_to(ROOT)))
def test_a_folder_names_its_files(folder: Path) -> None:
    said = docstring(folder)
    files = {path.stem for path in folder.glob("*.py")} - {"__init__"}
    ending = "" if folder == ROOT / "cgm_jax" else ".py"  # its programs are named as they are run
    assert [name for name in sorted(files) if f"{name}{ending}" not in said] == []


@pytest.mark.parametrize("folder", FOLDERS, ids=lambda folder: str(folder.relative_to(ROOT)))
def test_what_a_folder_names_is_there(folder: Path) -> None:
    named = {*re.findall(r"[\w*/]+\.py\b", docstring(folder))} - {"FILE.py"}
    # A path is one in the package, or in the repository.
    places = (ROOT / "cgm_jax", ROOT)
    wrong = [
        name
        for name in sorted(named)
        if not any([*place.glob(name)] for place in (places if "/" in name else (folder,)))
    ]
    assert wrong == []
