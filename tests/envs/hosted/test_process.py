"""The process of a Gymnasium environment: how it is asked, and how it ends."""

import importlib.metadata
import json
import os
import platform
import signal
import subprocess
import sys
import time
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cgm_jax.config.named import BY_PROGRAM
from cgm_jax.envs.hosted import process as hosted
from cgm_jax.envs.hosted.process import WORKER, HostedProcess, _end
from tests.cgm_jax.sweeps import ROOT

MODULE = "tests.envs.hosted.variants"
SEEDS = np.array([3, 1, 4], np.uint32)


def started(env_id: str, module: str = MODULE) -> HostedProcess:
    return HostedProcess(f"gymnasium:{module}:{env_id}", env_id, module, BY_PROGRAM)


def test_what_it_runs_on_is_known() -> None:
    runs_on = started("tests/Dense-v0").facts["runs_on"]
    assert runs_on["versions"]["gymnasium"] == importlib.metadata.version("gymnasium")
    assert runs_on["versions"]["Python"] == platform.python_version()
    file = ROOT / "tests" / "envs" / "hosted" / "variants.py"
    assert runs_on["files"][str(file)] == sha256(file.read_bytes()).hexdigest()


def interrupted(*_: Any) -> Any:
    raise KeyboardInterrupt


@pytest.mark.parametrize("moment", ["send", "receive"])
def test_an_interrupted_request_ends_the_process_and_no_later_one_gets_its_answer(
    moment: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    process = started("tests/Dense-v0")
    off = np.array([[0.0, 0.0], [1.0, 0.0]], np.float32)
    assert process.ask("success", off, 0.0 * off)[0].tolist() == [True, False]
    with monkeypatch.context() as patch:
        patch.setattr(hosted, moment, interrupted)
        with pytest.raises(KeyboardInterrupt):
            process.ask("reset", SEEDS)
    assert process._process.returncode == 0
    for _ in range(2):
        with pytest.raises(ValueError, match=r"^env: the process of .*Dense-v0 ended with 0$"):
            process.ask("success", off, 0.0 * off)


def test_a_process_that_dies_is_said_to_have_ended() -> None:
    process = started("tests/Dense-v0")
    process._process.kill()
    for _ in range(2):
        with pytest.raises(ValueError, match=r"^env: the process of .*Dense-v0 ended with -9$"):
            process.ask("reset", SEEDS)


def test_an_environment_may_write_into_what_it_is_given() -> None:
    process = started("tests/InPlace-v0")
    assert (process.facts["distance_threshold"], process.facts["remarks"]) == (0.1, [])
    achieved = np.array([[0.59, 1.0], [0.61, 1.0], [0.61, 1.0]], np.float32)
    desired = np.array([[0.5, 1.0], [0.5, 1.0], [0.6, 1.0]], np.float32)
    for _ in range(2):
        assert process.ask("success", achieved, desired)[0].tolist() == [True, False, True]


def test_at_its_end_all_is_closed_and_what_was_registered_for_the_exit_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("CLOSING_FILE", str(tmp_path / "lines"))
    process = started("tests/Closing-v0")
    process.ask("reset", SEEDS[:1])
    nothing, action = np.zeros(1, np.uint32), np.zeros((1, 2), np.float32)
    process.ask("step", nothing, nothing, SEEDS[:1], action)
    process.ask("reset", SEEDS[:1] + 1)
    popen = process._process
    del process  # the last reference
    assert popen.returncode == 0
    # One that was looked at, and one for each batch, the first of which was looked at before.
    assert (tmp_path / "lines").read_text().split() == ["close"] * 3 + ["exit"] * 3


@pytest.mark.parametrize(
    ("name", "number"), [("Hanging", signal.SIGTERM), ("Stubborn", signal.SIGKILL)]
)
def test_an_environment_that_hangs_in_close_is_forced_to_end(
    name: str, number: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(hosted, "GRACE_S", 1.0)
    process = started(f"tests/{name}-v0")
    popen = process._process
    del process
    assert popen.returncode == -number


def test_several_are_all_told_to_end_before_one_is_waited_for(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    calls: list[str] = []

    class Recorded:
        returncode, stdout = 0, None

        def __init__(self) -> None:
            self.stdin = self

        def close(self) -> None:
            calls.append("close")

        def wait(self, timeout: float) -> None:
            calls.append(f"wait {timeout}")

    monkeypatch.setattr(hosted, "_running", {Recorded(), Recorded()})
    hosted._end_all()
    assert calls[:2] == ["close", "close"]
    assert calls.count("wait 5.0") == 2
    assert hosted._running == set()


def test_programs_that_an_environment_starts_have_no_part_in_the_messages() -> None:
    process = started("tests/Reading-v0")  # it fails after 30 s where they have
    assert process.facts["episode_length"] == 25
    assert process.ask("reset", SEEDS)[0].shape == (3, 4)


def test_a_module_may_be_called_as_a_file_of_ours_is(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "rows.py").write_text(f"import {MODULE}\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    assert started("tests/Dense-v0", "rows").facts["goal_size"] == 2


BARE = """#!/bin/sh
exec {python} -I -S "$@"
"""
"""A Python without packages."""

CHATTY = """#!/bin/sh
echo welcome
exec {python} "$@"
"""


@pytest.mark.parametrize(
    ("script", "complaint"),
    [
        (
            BARE,
            r"ImportError: .* needs numpy and gymnasium: No module named '(numpy|gymnasium)' \(",
        ),
        (
            CHATTY,
            "what .*/other prints is no answer; it must be a Python that prints nothing by its",
        ),
    ],
)
def test_an_interpreter_that_does_not_serve_is_refused_in_one_line(
    script: str,
    complaint: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    other = tmp_path / "other"
    other.write_text(script.format(python=sys.executable))
    other.chmod(0o700)
    monkeypatch.setenv(hosted.INTERPRETER, str(other))
    with pytest.raises(
        ValueError, match=f"^env: gymnasium:.*:tests/Dense-v0: {complaint}"
    ) as error:
        started("tests/Dense-v0")
    assert "\n" not in str(error.value)
    assert capfd.readouterr().err == ""


def request(env_id: str) -> bytes:
    name = f"gymnasium:{MODULE}:{env_id}"
    values = {"path": sys.path, "id": env_id, "module": MODULE, "name": name, "trust": BY_PROGRAM}
    return json.dumps({"op": "begin", **values, "arrays": []}).encode() + b"\n"


@pytest.mark.parametrize("env_id", ["NumpyPointMass-v0", "Nothing-v0"])
def test_it_ends_without_a_word_where_nobody_takes_its_answer(env_id: str) -> None:
    pipe = subprocess.PIPE
    worker = subprocess.Popen([sys.executable, WORKER], stdin=pipe, stdout=pipe, stderr=pipe)
    assert worker.stdout is not None
    worker.stdout.close()
    worker.stdout = None
    _, errors = worker.communicate(request(env_id), timeout=60)
    assert (worker.returncode, errors) == (0, b"")


SHOWING_FACTS = """
from tests.envs.hosted.test_process import started
process = started("tests/Printing-v0")
process.ask("reset", __import__("numpy").zeros(2, "uint32"))
print(process.facts["episode_length"])
"""


@pytest.mark.parametrize("reader", ["closed", "full"])
def test_what_an_environment_prints_where_nobody_reads_it_ends_nothing(reader: str) -> None:
    read, write = os.pipe()
    if reader == "closed":
        os.close(read)
        errors = write
    else:
        os.close(read)
        os.close(write)
        errors = os.open("/dev/full", os.O_WRONLY)
    command = [sys.executable, "-c", SHOWING_FACTS]
    with os.fdopen(errors, "wb") as stderr:
        result = subprocess.run(
            command, stdout=subprocess.PIPE, stderr=stderr, timeout=120, check=False, cwd=ROOT
        )
    assert (result.returncode, result.stdout) == (0, b"25\n")


def test_what_an_environment_prints_is_passed_on(capfd: pytest.CaptureFixture[str]) -> None:
    process = started("tests/Printing-v0")
    _end(process._process)
    printed, deadline = "", time.monotonic() + 30.0
    while len(printed) < 25 * 10_001 and time.monotonic() < deadline:  # an episode, to look at it
        time.sleep(0.01)
        printed += capfd.readouterr().err
    assert {*printed.split()} == {"x" * 10_000}
    assert printed.count("\n") >= 25


def test_paths_among_the_folders_of_modules_are_passed_over(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(sys, "path", [*sys.path, Path("x")])
    assert started("tests/Dense-v0").facts["episode_length"] == 25


def test_another_interpreter_searches_the_folders_that_its_user_names(tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text("import tests.envs.hosted.variants\n")
    variables = {"PYTHONPATH": f"{tmp_path}{os.pathsep}{ROOT}", "PYTHONSAFEPATH": "1"}
    values = {"path": None, "id": "tests/Dense-v0", "module": "mine", "name": "x", "trust": ""}
    result = subprocess.run(
        [sys.executable, WORKER],
        input=json.dumps({"op": "begin", **values, "arrays": []}).encode() + b"\n",
        stdout=subprocess.PIPE,
        env={**os.environ, **variables},
        timeout=60,
        check=True,
    )
    assert json.loads(result.stdout.partition(b"\n")[0])["op"] == "facts"


@pytest.mark.slow
def test_an_environment_that_hangs_in_close_ends_though_nobody_is_left_to_force_it() -> None:
    pipe = subprocess.PIPE
    worker = subprocess.Popen([sys.executable, WORKER], stdin=pipe, stdout=pipe)
    answer, _ = worker.communicate(request("tests/Hanging-v0"), timeout=120)
    assert json.loads(answer)["op"] == "facts"
    assert worker.returncode == -signal.SIGALRM
