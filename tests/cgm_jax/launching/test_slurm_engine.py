"""What the engine makes of what SLURM says, in whose place stand functions; see test_slurm.py."""

import contextlib
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from cgm_jax.config.fields import SettingError
from cgm_jax.launching import slurm
from cgm_jax.launching.attempts import MAX_FRUITLESS
from cgm_jax.launching.directory import Launch, Resources
from cgm_jax.launching.record import append_event, events
from cgm_jax.launching.supervision import Ended


class Controller:
    """SLURM's, and submitit beside it: the states of jobs, and what was submitted."""

    def __init__(self) -> None:
        self.states: dict[str, str] = {}
        self.submitted: list[str] = []
        self.refuses = self.is_busy = False

    def job_states(self) -> dict[str, str]:
        if self.is_busy:
            raise SettingError("on: SLURM does not answer: busy")
        return dict(self.states)

    @contextlib.contextmanager
    def batch(self) -> Iterator[None]:
        yield

    def submit(self, job: slurm.PartJob) -> SimpleNamespace:
        if self.refuses:
            raise RuntimeError("sbatch:\nsbatch: error: invalid partition")
        self.submitted.append(Path(job.order.out).name)
        number = f"7_{len(self.submitted)}"
        self.states[number] = "PENDING"
        return SimpleNamespace(job_id=number)


@pytest.fixture
def controller(monkeypatch: pytest.MonkeyPatch) -> Controller:
    controller = Controller()
    monkeypatch.setattr(slurm, "job_states", controller.job_states)
    monkeypatch.setattr(slurm, "SQUEUE_SECONDS", 0.0)
    monkeypatch.setattr(slurm.shutil, "which", lambda program: f"/usr/bin/{program}")
    monkeypatch.setattr(slurm.importlib.util, "find_spec", lambda name: name)
    return controller


@pytest.fixture
def launch(tmp_path: Path) -> Launch:
    launch = Launch(tmp_path / "out", "slurm", 2, "smoke", (), Resources())
    launch.path.mkdir()
    launch.write()
    return launch


def engine(controller: Controller, launch: Launch) -> slurm.Slurm:
    made: Any = slurm.Slurm(launch.resources)
    made._launch, made._executor = launch, controller
    return made


def test_a_job_that_is_away_for_a_moment_has_not_ended(
    controller: Controller, launch: Launch
) -> None:
    one = engine(controller, launch)
    assert one.start([1, 2]) == [1, 2]
    assert controller.submitted == ["1", "2"]
    del controller.states["7_1"]
    assert one.ended() == {}
    controller.states["7_1"] = "RUNNING"  # it was requeued
    assert one.ended() == {}
    del controller.states["7_1"]
    assert one.ended() == {}
    assert one.ended() == {1: Ended(None)}
    assert one.ended() == {}


def test_a_part_that_is_done_has_ended_with_its_job(controller: Controller, launch: Launch) -> None:
    one = engine(controller, launch)
    one.start([1, 2])
    append_event(launch.record(1), "ended", code=0)
    controller.states["7_1"] = "COMPLETED"
    assert one.ended() == {1: Ended(0)}


@pytest.mark.parametrize(("code", "end"), [(None, Ended(75, True)), (1, Ended(1, True))])
def test_a_job_that_its_user_cancels_is_not_tried_again(
    code: int | None, end: Ended, controller: Controller, launch: Launch
) -> None:
    one = engine(controller, launch)
    one.start([1])
    if code is not None:
        append_event(launch.record(1), "ended", code=code)
    controller.states["7_1"] = "CANCELLED"
    assert [one.ended(), one.ended()] == [{}, {1: end}]


def test_a_busy_controller_ends_nothing(controller: Controller, launch: Launch) -> None:
    one = engine(controller, launch)
    one.start([1])
    controller.states.clear()
    assert one.ended() == {}
    controller.is_busy = True
    assert [one.ended() for _ in range(3)] == [{}] * 3
    controller.is_busy = False
    assert one.ended() == {1: Ended(None)}


def test_what_slurm_refuses_at_first_is_refused_and_later_tried_again(
    controller: Controller, launch: Launch, capsys: pytest.CaptureFixture[str]
) -> None:
    one, controller.refuses = engine(controller, launch), True
    line = "on: SLURM refuses the jobs: sbatch: error: invalid partition"
    with pytest.raises(SettingError, match=f"^{line}$"):
        one.start([1, 2])
    controller.refuses = False
    assert one.start([1]) == [1]
    controller.refuses = True
    assert one.start([2]) == []
    assert capsys.readouterr().err == f"{line}; it is tried again\n"


def test_jobs_of_an_earlier_launcher_are_taken_up_and_those_that_have_gone_replaced(
    controller: Controller, launch: Launch
) -> None:
    engine(controller, launch).start([1, 2])
    controller.states["7_1"] = "TIMEOUT"
    again = engine(controller, launch)
    assert again.start([1, 2]) == [1, 2]
    assert controller.submitted == ["1", "2", "1"]
    assert again._jobs == {1: "7_3", 2: "7_2"}
    jobs = [entry["job"] for entry in events(launch.record(1)) if entry["event"] == "submitted"]
    assert jobs == ["7_1", "7_3"]
    assert again.detached == "the jobs go on in SLURM; to end them: scancel 7"


def test_a_job_makes_no_attempt_once_too_many_have_come_no_further(launch: Launch) -> None:
    order = launch.order(1, 1, {})
    for _ in range(MAX_FRUITLESS):
        append_event(launch.record(1), "started", position=[])
    append_event(launch.record(1), "ended", code=75)
    pytest.importorskip("submitit")
    assert slurm.PartJob(order)() == 75
    assert not launch.out(1).exists()


def test_a_job_is_asked_for_before_anything_is_made(
    controller: Controller, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[Any] = []
    monkeypatch.setattr(slurm, "_answer", asked.append)
    resources = Resources(cores=4, memory=1.5, gpus=1, sbatch=("partition=main", "exclusive"))
    slurm.Slurm(resources).check()
    options = ["--time=60", "--cpus-per-task=4", "--gpus-per-node=1", "--mem=1536M"]
    options += ["--partition=main", "--exclusive"]
    assert asked == [["sbatch", "--test-only", *options, "--wrap=true"]]

    def refuse(_: Any) -> None:
        raise slurm._NoAnswerError("sbatch: error: invalid partition specified: main")

    monkeypatch.setattr(slurm, "_answer", refuse)
    with pytest.raises(SettingError, match=r"^on: SLURM refuses the jobs: .* specified: main$"):
        slurm.Slurm(resources).check()


def test_jobs_that_may_have_to_wait_are_not_refused(
    controller: Controller, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    said = "allocation failure: Requested node configuration is not available"

    def wait(_: Any) -> None:
        raise slurm._NoAnswerError(said)

    monkeypatch.setattr(slurm, "_answer", wait)
    slurm.Slurm(Resources()).check()
    assert capsys.readouterr().err == f"on: SLURM may not run the jobs: {said}\n"
