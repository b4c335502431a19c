import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]

PROGRAM = """
import sys
from pathlib import Path
from cgm_jax import envs
assert Path(envs.__file__).is_relative_to(sys.argv[1]), envs.__file__
from cgm_jax.results.page.page import FOLDER, LIBRARIES
parts = ("page.html", "page.css", "js/page.js", "vendor/LICENSE-d3", "vendor/LICENSE-plot")
assert all((FOLDER / name).is_file() for name in (*parts, *LIBRARIES)), FOLDER
for task in envs.TASKS:
    print(envs.make(task, engine="native").scene.model.nq)
"""


@pytest.mark.slow
def test_the_wheel_alone_finds_its_assets_from_an_empty_folder(tmp_path: Path) -> None:
    build = [sys.executable, "-m", "build", "--wheel", "--no-isolation", "--outdir", str(tmp_path)]
    subprocess.run([*build, str(ROOT)], check=True, capture_output=True)
    (wheel,) = tmp_path.glob("*.whl")
    site, empty = tmp_path / "site", tmp_path / "empty"
    empty.mkdir()
    install = [sys.executable, "-m", "pip", "install", "--no-deps", "--target", str(site)]
    subprocess.run([*install, str(wheel)], check=True, capture_output=True)
    result = subprocess.run(
        [sys.executable, "-c", PROGRAM, str(site)],
        cwd=empty,
        env={"PYTHONPATH": str(site)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert result.returncode == 0, result.stderr
    assert result.stdout.split() == ["9", "16", "16"]
