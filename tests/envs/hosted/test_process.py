"""The process of a Gymnasium environment: how it is asked, and how it ends."""

from pathlib import Path

import pytest

from cgm_jax.config.named import BY_PROGRAM
from cgm_jax.envs.hosted.process import HostedProcess

MODULE = "tests.envs.hosted.variants"


def started(env_id: str, module: str = MODULE) -> HostedProcess:
    return HostedProcess(f"gymnasium:{module}:{env_id}", env_id, module, BY_PROGRAM)


def test_a_module_may_be_called_as_a_file_of_ours_is(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "rows.py").write_text(f"import {MODULE}\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    assert started("tests/Dense-v0", "rows").facts["goal_size"] == 2
