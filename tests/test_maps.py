"""A folder's docstring is its map: it names every file."""

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
FOLDERS = sorted(
    path.parent
    for room in ("cgm_jax", "envs", "experiments")
    for path in (ROOT / room).rglob("__init__.py")
    if not path.is_relative_to(ROOT / "cgm_jax" / "envs")  # a link to envs
)


@pytest.mark.parametrize("folder", FOLDERS, ids=lambda folder: str(folder.relative_to(ROOT)))
def test_a_folder_names_its_files(folder: Path) -> None:
    said = ast.get_docstring(ast.parse((folder / "__init__.py").read_text())) or ""
    files = {path.stem for path in folder.glob("*.py")} - {"__init__"}
    ending = "" if folder == ROOT / "cgm_jax" else ".py"  # its programs are named as they are run
    assert [name for name in sorted(files) if f"{name}{ending}" not in said] == []
