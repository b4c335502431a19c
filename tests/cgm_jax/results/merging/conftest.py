"""Three parts of a sweep, made up; no figures are drawn of the whole."""

from pathlib import Path

import pytest

from cgm_jax.results import figures
from tests.cgm_jax.results.merging.made_parts import train, whole


@pytest.fixture
def parts(tmp_path: Path) -> list[Path]:
    groups = whole()
    return [train(tmp_path / f"part{part}", groups, part, 3) for part in (1, 2, 3)]


@pytest.fixture(autouse=True)
def no_figures(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(figures, "draw_figures", lambda _: None)
