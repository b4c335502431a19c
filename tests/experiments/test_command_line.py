"""Programs that take paths refuse what is none."""

import sys
from pathlib import Path

import pytest

from experiments.command_line import paths


def given(monkeypatch: pytest.MonkeyPatch, *words: str) -> list[Path]:
    monkeypatch.setattr(sys, "argv", ["program", *words])
    return paths("a.program", "What it does.", "recording", "out")


def test_paths_come_in_their_order(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    (tmp_path / "b.npz").touch()
    assert given(monkeypatch, str(tmp_path / "b.npz"), "a") == [tmp_path / "b.npz", Path("a")]


def test_a_recording_that_is_not_there_is_refused(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit, match="2"):
        given(monkeypatch, "nowhere.npz", "a")
    assert "recording: there is no file nowhere.npz" in capsys.readouterr().err


@pytest.mark.parametrize("words", [(), ("a.npz",), ("a.npz", "b", "c"), ("a.npz", "--b")])
def test_what_is_no_path_is_refused(monkeypatch: pytest.MonkeyPatch, words: tuple[str]) -> None:
    with pytest.raises(SystemExit, match="2"):
        given(monkeypatch, *words)


def test_help_is_no_path(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit, match="0"):
        given(monkeypatch, "--help")
    assert "What it does." in capsys.readouterr().out
