"""Sweeps on the point mass in this process: their programs compile once for all files' tests."""

import functools
from collections.abc import Iterator
from pathlib import Path
from unittest import mock

import pytest

from cgm_jax.host import jobs, session
from cgm_jax.results import figures
from tests.cgm_jax.host.in_process import train
from tests.cgm_jax.shared_programs import SharedPrograms
from tests.examples.point_mass import PointMass


@pytest.fixture(scope="session")
def shared_programs() -> Iterator[SharedPrograms]:
    shared = SharedPrograms()
    yield shared
    shared.close()


@pytest.fixture
def in_process(shared_programs: SharedPrograms, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Sweeps of a test share programs, draw no figures, and never end pytest itself."""
    monkeypatch.setattr(figures, "draw_figures", lambda _: [])
    monkeypatch.setattr(jobs, "make_environment", lambda _: PointMass())
    # The default would end pytest, were the machine slow.
    patient = functools.partial(session.Interruption, patience=300.0)
    monkeypatch.setattr(session, "Interruption", patient)
    with shared_programs.used():
        yield


@pytest.fixture(scope="session")
def whole(tmp_path_factory: pytest.TempPathFactory, shared_programs: SharedPrograms) -> Path:
    """A sweep that nothing has disturbed."""
    out = tmp_path_factory.mktemp("whole") / "out"
    with (
        mock.patch.object(figures, "draw_figures"),
        mock.patch.object(jobs, "make_environment", return_value=PointMass()),
        shared_programs.used(),
    ):
        assert train(out) == 0
    return out
