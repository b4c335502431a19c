"""Attempts at parts whose sweeps are stand-ins (child.py): what is tried again, and what is not."""

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from cgm_jax.launching import attempts, supervision
from cgm_jax.launching.attempts import MAX_FRUITLESS, Attempt, Step, next_step
from cgm_jax.launching.cores import Cores
from cgm_jax.launching.directory import Launch, Resources
from cgm_jax.launching.local import Local
from cgm_jax.launching.record import append_event, events, last_code
from cgm_jax.launching.supervision import Ended, supervise, verdict
from cgm_jax.storage.lock import locked

CHILD = str(Path(__file__).with_name("child.py"))
PYTHON = [sys.executable, "-I", "-S", CHILD]


@pytest.fixture(autouse=True)
def fast(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(supervision, "POLL_SECONDS", 0.01)
    monkeypatch.setattr(attempts, "POLL_SECONDS", 0.01)
    monkeypatch.setattr(supervision, "MAX_DELAY", 0.0)


@pytest.fixture
def made(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., Launch]:
    """A launch whose parts do what these steps say."""

    def make(*parts: list[str]) -> Launch:
        def command(launch: Launch, part: int) -> list[str]:
            return [*PYTHON, str(launch.out(part)), *parts[part - 1]]

        monkeypatch.setattr(Launch, "command", command)
        launch = Launch(tmp_path / "out", "local", len(parts), "smoke", (), Resources(cores=1))
        launch.path.mkdir()
        launch.write()
        return launch

    return make


def run(launch: Launch, requested: Callable[[], bool] = lambda: False) -> Mapping[int, int] | None:
    class Signals:
        @property
        def requested(self) -> bool:
            return requested()

    interruption: Any = Signals()
    epochs = dict.fromkeys(range(1, launch.parts + 1), 4)
    return supervise(launch, Local(launch.parts, launch.resources), epochs, interruption)


def starts(launch: Launch, part: int = 1) -> list[dict[str, Any]]:
    lines = (launch.out(part) / "starts").read_text().splitlines()
    return [json.loads(line) for line in lines]


@pytest.mark.parametrize(
    ("steps", "code", "count"),
    [
        (["1:0"], 0, 1),
        (["1:3"], 3, 1),  # done, but some runs diverged
        (["1:75", "1:74", "1:kill", "1:0"], 0, 4),
        (["0:2"], 2, 1),  # refused input is refused again
        (["1:1"], 1, 1),
        (["1:75", "0:75"], 75, 1 + MAX_FRUITLESS),  # a part that comes no further
        (["0:kill"], -9, MAX_FRUITLESS),
    ],
)
def test_what_ended_an_attempt_from_outside_is_tried_again_while_there_is_progress(
    made: Callable[..., Launch], steps: list[str], code: int, count: int
) -> None:
    launch = made(steps)
    assert run(launch) == {1: code}
    assert len(starts(launch)) == count
    assert last_code(launch.record(1)) == code


class Absent:
    """Attempts that end before they begin, as of jobs whose interpreter is not on their node."""

    detached = ""

    def __init__(self) -> None:
        self.started: list[int] = []
        self._running: list[int] = []

    def begin(self, launch: Launch) -> None: ...

    def room(self) -> int:
        return 9

    def start(self, parts: Sequence[int]) -> Sequence[int]:
        self.started += parts
        self._running += parts
        return parts

    def ended(self) -> dict[int, Ended]:
        ended = {part: Ended(None) for part in self._running}
        self._running = []
        return ended


def test_attempts_that_never_begin_are_not_made_for_ever(
    made: Callable[..., Launch], capsys: pytest.CaptureFixture[str]
) -> None:
    launch, engine, interruption = made([], []), Absent(), SimpleNamespace(requested=False)
    assert supervise(launch, engine, {1: 4, 2: 4}, interruption) == {1: 1, 2: 1}  # pyright: ignore
    assert sorted(engine.started) == [1] * MAX_FRUITLESS + [2] * MAX_FRUITLESS
    assert "it was lost, and 5 attempts in a row have come no further" in capsys.readouterr().err


def test_where_no_record_can_be_written_attempts_are_counted_all_the_same(
    made: Callable[..., Launch],
) -> None:
    launch = made(["1:75", "0:74"])
    launch.record(1).mkdir()
    assert run(launch) == {1: 74}
    assert len(starts(launch)) == 1 + MAX_FRUITLESS


def test_one_part_that_fails_leaves_the_others_alone(
    made: Callable[..., Launch], capsys: pytest.CaptureFixture[str]
) -> None:
    launch = made(["0:2"], ["1:0"], ["1:kill", "1:0"])
    assert run(launch) == {1: 2, 2: 0, 3: 0}
    said = capsys.readouterr().err
    assert "part 1: it ended with exit code 2; error: kappa: is bad?[2J\n" in said
    assert "part 3: it was killed by signal 9; it is tried again\n" in said


def test_a_launch_begins_to_count_anew(made: Callable[..., Launch]) -> None:
    launch = made(["0:75"])
    assert run(launch) == run(launch) == {1: 75}
    assert len(starts(launch)) == 2 * MAX_FRUITLESS


def test_a_stopped_launch_ends_its_children_by_one_sigterm(made: Callable[..., Launch]) -> None:
    launch = made(["1:wait"])
    assert run(launch, lambda: (launch.out(1) / "checkpoints").exists()) is None
    assert (launch.out(1) / "terminations").read_text() == "1"
    assert last_code(launch.record(1)) == 75


def test_an_attempt_waits_for_another_that_still_trains(
    made: Callable[..., Launch], monkeypatch: pytest.MonkeyPatch
) -> None:
    launch = made(["1:0"])
    launch.out(1).mkdir()
    attempt = Attempt(launch.order(1, None))
    with locked(launch.out(1)):
        assert [attempt.poll() for _ in range(3)] == [None] * 3
        monkeypatch.setattr(attempts, "LOCK_PATIENCE", 0.0)
        assert Attempt(launch.order(1, None)).run() == 75  # in vain: try again later
        assert not (launch.out(1) / "starts").exists()
    assert attempt.run() == 0


def test_children_are_held_to_cores_of_their_own_and_never_see_warnings(
    made: Callable[..., Launch],
) -> None:
    launch = made(["1:wait"], ["1:wait"])
    both = [launch.out(part) / "checkpoints" for part in (1, 2)]
    assert run(launch, lambda: all(path.exists() for path in both)) is None
    first, second = starts(launch, 1)[0], starts(launch, 2)[0]
    if len(os.sched_getaffinity(0)) > 1:
        assert len(first["cores"]) == len(second["cores"]) == 1
    assert {signal.SIGUSR1, signal.SIGUSR2} <= {*first["blocked"]}
    assert not {signal.SIGUSR1, signal.SIGUSR2} & signal.pthread_sigmask(signal.SIG_BLOCK, [])


@pytest.mark.skipif(len(os.sched_getaffinity(0)) < 2, reason="needs two cores")
def test_cores_are_claimed_by_one_attempt_at_a_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    there = sorted(os.sched_getaffinity(0))
    first, second = Cores(1), Cores(1)
    assert [first.numbers, second.numbers] == [there[:1], there[1:2]]
    first.release()
    third = Cores(1)
    assert third.numbers == there[:1]
    third.release()
    assert Cores(None).numbers == Cores(len(there)).numbers == []
    with second.inherited():
        assert os.sched_getaffinity(0) == {there[1]}
    assert sorted(os.sched_getaffinity(0)) == there
    second.release()


def test_a_child_ends_when_its_attempt_is_killed(made: Callable[..., Launch]) -> None:
    launch = made(["1:wait"])
    order = launch.order(1, None).to_json()
    with subprocess.Popen([sys.executable, "-m", "cgm_jax.launching.attempts", order]) as process:
        wait_for(launch.out(1) / "checkpoints")
        process.kill()
    wait_for(launch.out(1) / "terminations")  # Linux signals once for each thread of the parent


def wait_for(path: Path) -> None:
    deadline = time.monotonic() + 60
    while not path.exists():
        assert time.monotonic() < deadline, path
        time.sleep(0.02)
    time.sleep(0.05)  # until it is written


def test_an_attempt_ends_when_whoever_started_it_is_gone(made: Callable[..., Launch]) -> None:
    launch = made(["1:wait"])
    order = launch.order(1, None).to_json()
    parent = (
        "import subprocess, sys, time\n"
        "subprocess.Popen([sys.executable, '-m', 'cgm_jax.launching.attempts', sys.argv[1]])\n"
        "time.sleep(60)"
    )
    with subprocess.Popen([sys.executable, "-c", parent, order]) as process:
        wait_for(launch.out(1) / "checkpoints")
        process.kill()
    wait_for(launch.out(1) / "terminations")
    while last_code(launch.record(1)) is None:
        time.sleep(0.02)
    assert (launch.out(1) / "terminations").read_text() == "1"
    assert [event["event"] for event in events(launch.record(1))] == ["started", "ended"]


@pytest.mark.parametrize(
    ("code", "step"),
    [
        (0, Step.DONE),
        (3, Step.DONE),
        (1, Step.FAILED),
        (2, Step.FAILED),
        (74, Step.AGAIN),
        (75, Step.AGAIN),
        (-9, Step.AGAIN),
        (137, Step.AGAIN),  # as a shell tells of signal 9
        (None, Step.AGAIN),  # a lost node
    ],
)
def test_the_next_step(code: int | None, step: Step) -> None:
    assert next_step(code, 0) is step
    tired = Step.FAILED if step is Step.AGAIN else step
    assert next_step(code, MAX_FRUITLESS) is tired


@pytest.mark.parametrize(
    ("codes", "code"),
    [
        ([0, 2, 1], 2),
        ([75, 1, 0], 1),
        ([75, 74], 74),
        ([0, 75, 3], 75),
        ([0, -9], 1),
        ([75, -9], 1),
    ],
)
def test_the_exit_code_of_a_launch_is_that_of_its_worst_part(codes: list[int], code: int) -> None:
    assert verdict(dict(enumerate(codes))) == code


def test_torn_lines_in_a_record_are_passed_over(tmp_path: Path) -> None:
    record = tmp_path / "1.jsonl"
    record.write_text('{"event": "started"}\n{"event": "ended", "code": 75}\n3\n{"event": "sta')
    assert [entry["event"] for entry in events(record)] == ["started", "ended"]
    assert last_code(record) == 75
    assert last_code(tmp_path / "none") is None
    append_event(record, "launched")  # which the torn line does not swallow
    append_event(record, "started")
    assert [entry["event"] for entry in events(record)][2:] == ["launched", "started"]


def test_an_error_of_an_earlier_attempt_is_not_given_for_this_one(
    made: Callable[..., Launch], capsys: pytest.CaptureFixture[str]
) -> None:
    launch = made(["0:kill"])
    launch.log(1).write_text("error: cannot write to runs/a: No space left on device\n")
    assert run(launch) == {1: -9}
    line = capsys.readouterr().err.splitlines()[-1]
    assert line.endswith(f"5 attempts in a row have come no further; see {launch.log(1)}")
