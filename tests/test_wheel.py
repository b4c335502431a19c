"""The package beside folders of the same names, from a checkout and from a wheel."""

import ast
import importlib.metadata
import os
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest

import cgm_jax
from tests.readme_commands import ROOT, commands, make_clashing, programs
from tests.test_public_imports import PUBLIC

IMPORTS = "\n".join(
    f"from {module} import {name}" for module, name in PUBLIC if "stable_baselines3" not in module
)
PROGRAM = f"""
import sys
{IMPORTS}
import cgm_jax, cgm_jax.envs
for task in cgm_jax.envs.TASKS:
    print(cgm_jax.envs.make(task, engine="native").scene.model.nq)
import gymnasium
print(gymnasium.make("cgm_jax/FetchPush-v0").reset(seed=0)[0]["observation"].shape)
print(cgm_jax.__file__, cgm_jax.__version__)
from cgm_jax.results.page.page import FOLDER, LIBRARIES, LICENCES
parts = ("page.html", "page.css", "js/page.js", *LICENCES)
assert all((FOLDER / name).is_file() for name in (*parts, *LIBRARIES)), FOLDER
"""


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("wheel")
    build = [sys.executable, "-m", "build", "--wheel", "--no-isolation", "--outdir", str(folder)]
    subprocess.run([*build, str(ROOT)], check=True, capture_output=True)
    (path,) = folder.glob("*.whl")
    return path


@pytest.fixture(scope="module")
def installed(wheel: Path) -> Path:
    """The folder into which the wheel is unpacked, which is what pip does with one that is pure."""
    site = wheel.parent / "site"
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(site)
    return site


def run(place: Path, folder: Path, *words: str) -> subprocess.CompletedProcess[str]:
    """Run Python in a folder, with the package from a place."""
    return subprocess.run(
        [sys.executable, *words],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(place)},
        capture_output=True,
        text=True,
        check=False,
    )


@pytest.mark.slow
@pytest.mark.parametrize("source", ["checkout", "wheel"])
def test_imports_commands_and_gymnasium_beside_folders_of_the_same_names(
    source: str, request: pytest.FixtureRequest, tmp_path: Path
) -> None:
    place = ROOT if source == "checkout" else request.getfixturevalue("installed")
    make_clashing(tmp_path)
    result = run(place, tmp_path, "-c", PROGRAM)
    assert result.returncode == 0, result.stderr
    *sizes, file, version = result.stdout.split()
    assert sizes == ["9", "16", "16", "(25,)"]
    assert Path(file).parent == place / "cgm_jax"
    assert version == cgm_jax.__version__
    for path in (place / "cgm_jax").glob("[!_]*.py"):
        if "__main__" in path.read_text():
            result = run(place, tmp_path, "-m", f"cgm_jax.{path.stem}", "--help")
            assert result.returncode == 0, result.stderr
            assert "usage" in result.stdout
    for command in (
        ["train", "--preset", "smoke", "--out", "out"],
        ["evaluate", "out", "--episodes", "2"],
        ["sweep", "--resume", "out"],
    ):
        result = run(place, tmp_path, "-m", f"cgm_jax.{command[0]}", *command[1:])
        assert result.returncode == 0, result.stderr


@pytest.mark.slow
def test_a_wheel_brings_one_name_and_its_types(wheel: Path) -> None:
    names = zipfile.ZipFile(wheel).namelist()
    assert {name.split("/")[0] for name in names if ".dist-info/" not in name} == {"cgm_jax"}
    assert {"cgm_jax/py.typed", "cgm_jax/envs/fetch.py", "cgm_jax/assets/fetch/reach.xml"} <= {
        *names
    }
    assert f"-{cgm_jax.__version__}-" in wheel.name


def test_the_version_is_written_in_one_place() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())
    assert project["project"]["dynamic"] == ["version"]
    assert project["tool"]["hatch"]["version"] == {"path": "cgm_jax/__init__.py"}
    assert f"## {cgm_jax.__version__}" in (ROOT / "CHANGELOG.md").read_text()


def test_the_lock_is_within_the_ranges_and_exact() -> None:
    from packaging.requirements import Requirement

    lines = (ROOT / "requirements.lock").read_text().splitlines()
    pinned = dict(line.split("==") for line in lines if "==" in line)
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    for text in project["dependencies"]:
        wanted = Requirement(text)
        assert wanted.specifier.contains(pinned[wanted.name]), text
        ends = {part.operator for part in wanted.specifier}
        assert ends == ({"=="} if "mujoco" in wanted.name else {">=", "<"}), text
    assert pinned["mujoco"] == pinned["mujoco-mjx"] == importlib.metadata.version("mujoco")


def test_commands_of_the_readme_are_found_and_are_small() -> None:
    found = commands()
    assert len(found) > 8
    for words in found:
        if words[1] in ("cgm_jax.train", "cgm_jax.sweep", "cgm_jax.launch"):
            assert {"smoke", "--config", "--resume"} & {*words}, words
    assert len(programs()) >= 2
    for program in programs():
        ast.parse(program)
