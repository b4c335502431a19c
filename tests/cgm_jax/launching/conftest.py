"""Working directories and launches of tests."""

from pathlib import Path
from typing import Any

import pytest

from cgm_jax import launch as program
from cgm_jax.launching.directory import Launch


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty working directory."""
    folder = tmp_path / "work"
    folder.mkdir()
    monkeypatch.chdir(folder)
    return folder


@pytest.fixture
def planned(monkeypatch: pytest.MonkeyPatch) -> list[Launch]:
    """Launches that would have been run."""
    found: list[Launch] = []

    def run(launch: Launch, *_: Any) -> int:
        found.append(launch)
        return 0

    monkeypatch.setattr(program, "_run", run)
    monkeypatch.setattr(program, "check_sweep", lambda *_, **__: None)
    return found
