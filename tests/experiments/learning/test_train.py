import os
import subprocess
from pathlib import Path
from typing import Any

import pytest

from experiments.learning import train as module
from experiments.learning.train import shares_of_cores, train


@pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="processes cannot be bound")
def test_sweeps_at_once_have_a_share_of_the_cores_each(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen: dict[str, set[int]] = {}

    def run(command: list[str], **_: Any) -> subprocess.CompletedProcess[str]:
        seen[Path(command[-1]).name] = os.sched_getaffinity(0)
        return subprocess.CompletedProcess(command, 0)

    monkeypatch.setattr(module.subprocess, "run", run)
    before = os.sched_getaffinity(0)
    train({"a": ["--preset", "smoke"], "b": ["--preset", "smoke"]}, tmp_path, at_once=2)
    assert set(seen) == {"a", "b"}
    assert all(cores in shares_of_cores(2) for cores in seen.values())
    train({"c": ["--preset", "smoke"]}, tmp_path)
    assert seen["c"] == before == os.sched_getaffinity(0)


def test_every_core_is_dealt_out_and_no_share_is_empty() -> None:
    cores = os.sched_getaffinity(0)
    assert set().union(*shares_of_cores(2)) == cores
    assert all(shares_of_cores(len(cores) + 3))
    assert shares_of_cores(1) == [cores]


def test_a_sweep_that_is_stopped_ends_the_program_with_its_code_and_begins_no_other(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    begun = []

    def run(command: list[str], **_: Any) -> subprocess.CompletedProcess[str]:
        begun.append(Path(command[-1]).name)
        return subprocess.CompletedProcess(command, 75 if begun == ["a"] else 0)

    monkeypatch.setattr(module.subprocess, "run", run)
    with pytest.raises(SystemExit) as end:
        train({name: ["--preset", "smoke"] for name in "abcdefgh"}, tmp_path)
    assert end.value.code == 75
    assert begun == ["a"]
