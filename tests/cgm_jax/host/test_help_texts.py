"""What --help looks like: no line breaks of docstrings, no word of Python's."""

import importlib
import re
from pathlib import Path

import pytest

PROGRAMS = [
    *("train", "sweep", "evaluate", "report", "export", "launch", "merge"),
    "benchmark",
]


def shown(program: str, capsys: pytest.CaptureFixture[str]) -> str:
    """The text of --help on one line, without its boxes."""
    with pytest.raises(SystemExit) as end:
        importlib.import_module(f"cgm_jax.{program}").main(["--help"])
    assert end.value.code == 0
    return " ".join(re.sub(r"[│╭╮╰╯─]", " ", capsys.readouterr().out).split())


def test_every_program_is_tried() -> None:
    folder = Path(importlib.import_module("cgm_jax").__file__ or "").parent
    assert {*PROGRAMS} == {
        path.stem for path in folder.glob("[!_]*.py") if "parse(" in path.read_text()
    }


@pytest.mark.parametrize("program", PROGRAMS)
def test_options_that_may_be_left_out_are_shown_without_python(
    program: str, capsys: pytest.CaptureFixture[str]
) -> None:
    text = shown(program, capsys)
    assert not re.findall(r"\{?None\}?\||default: (?:None|False|''|\))|LITERAL", text)


@pytest.mark.parametrize(
    ("program", "expected"),
    [
        ("evaluate", "[PATH] Directory that a sweep or a training run has written, or one policy"),
        ("evaluate", "--env STR [STR ...] For --random,"),
        ("evaluate", "--episodes INT Episodes per policy. (default: 200)"),
        ("launch", "--on {local,slurm,ray} Where parts are trained. (default: local)"),
        ("merge", "PATH [PATH ...] Directories of all parts, in any order. "),
        ("report", "DIR [DIR ...] Directories that sweeps or training runs have written. "),
        ("train", "--from DIR|FILE.npz Start from what another run has learned"),
        ("train", "has no effect on results. (default: 300.0)"),
        ("train", "--epochs INT epochs, each"),
        ("sweep", "--epochs INT [INT ...] epochs, each"),
    ],
)
def test_words_for_values(program: str, expected: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert expected in shown(program, capsys)


def test_lines_end_where_the_terminal_does_and_not_the_docstring(
    capsys: pytest.CaptureFixture[str],
) -> None:
    with pytest.raises(SystemExit):
        importlib.import_module("cgm_jax.train").main(["--help"])
    lines = [line.strip("│ ") for line in capsys.readouterr().out.splitlines()]
    assert any("resume it. Its settings" in line for line in lines)
