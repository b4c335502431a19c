import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import matplotlib.image
import pytest
from matplotlib.figure import Figure

from cgm_jax.results.figures import draw_figures, save_figure
from cgm_jax.storage.run_directory import RunDirectory
from tests.cgm_jax.results.figures.made import run, sweep


@pytest.fixture
def directory(tmp_path: Path) -> RunDirectory:
    (tmp_path / "figures").mkdir()
    return RunDirectory(tmp_path)


def write(directory: RunDirectory, rows: list[object]) -> None:
    (directory.path / "metrics.jsonl").write_text("".join(json.dumps(row) + "\n" for row in rows))


def test_figures_that_make_no_sense_are_left_out_without_a_word(
    directory: RunDirectory, capsys: pytest.CaptureFixture[str]
) -> None:
    write(directory, run([0.1, 0.2], curriculum="full"))
    (directory.path / "figures" / "mask_success.png").write_bytes(b"of an older version")
    assert [path.name for path in draw_figures(directory)] == ["learning_curves.png"]
    assert [path.name for path in (directory.path / "figures").iterdir()] == ["learning_curves.png"]
    assert capsys.readouterr() == ("", "")


def test_a_figure_that_would_be_missed_is_a_line(
    directory: RunDirectory, capsys: pytest.CaptureFixture[str]
) -> None:
    levels: dict[str, Any] = {"level": [0.0, 0.5, 1.0], "level_probability": [0.2, 0.3, 0.5]}
    write(directory, run([0.1, 0.2], reported=[*levels], **levels))
    drawn = [path.name for path in draw_figures(directory)]
    assert drawn == ["learning_curves.png", "curriculum.png"]
    assert capsys.readouterr().err.splitlines() == [
        "mask_success.png is not drawn: masks are too many to count each; curriculum.png shows "
        "them by success"
    ]


def test_a_figure_that_cannot_be_drawn_is_said_and_costs_no_other(
    directory: RunDirectory, capsys: pytest.CaptureFixture[str]
) -> None:
    write(directory, run([0.1], reported=["level"], level=[0.5], mask_rate_estimated=["?", "?"]))
    drawn = [path.name for path in draw_figures(directory)]
    assert drawn == ["learning_curves.png", "curriculum.png"]
    assert "mask_success.png is not drawn: ValueError: " in capsys.readouterr().err


def test_a_very_long_figure_stays_of_a_size_that_can_be_opened(tmp_path: Path) -> None:
    save_figure(Figure(figsize=(2, 400)), tmp_path / "long.png")
    assert matplotlib.image.imread(tmp_path / "long.png").shape[:2] == (30_000, 150)


def test_matplotlib_is_left_as_it_was(directory: RunDirectory) -> None:
    write(directory, sweep(lambda **_: [0.1], c_g=[0.1, 0.4]))
    program = """
import sys
from pathlib import Path
import matplotlib
matplotlib.use("svg")
from cgm_jax.results.figures import draw_figures
from cgm_jax.storage.run_directory import RunDirectory
assert len(draw_figures(RunDirectory(Path(sys.argv[1])))) == 2
assert matplotlib.get_backend() == "svg"
assert "matplotlib.pyplot" not in sys.modules
"""
    command = [sys.executable, "-c", program, str(directory.path)]
    subprocess.run(command, check=True, timeout=300)
