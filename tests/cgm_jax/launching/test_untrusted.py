"""What a directory of a launch may hold that comes from somebody else."""

import json
import os
import shutil
import stat
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from cgm_jax import launch as program
from cgm_jax.config import named
from cgm_jax.config.fields import SettingError
from cgm_jax.launching import ray, slurm
from cgm_jax.launching.attempts import Attempt, Order
from cgm_jax.launching.directory import Launch, Resources
from cgm_jax.storage.run_directory import RunDirectory
from tests.cgm_jax.launching.launches import SMOKE
from tests.cgm_jax.sweeps import POINT_MASS, ROOT

MY_TRACKER = ROOT / "tests/examples/my_tracker.py"


def test_a_launch_from_elsewhere_runs_no_code_that_was_not_named(
    folder: Path, planned: list[Launch], monkeypatch: pytest.MonkeyPatch
) -> None:
    ran = folder / "ran"
    (folder / "x.py").write_text(
        f"import pathlib\npathlib.Path({str(ran)!r}).touch()\n"
        "from launched_point import PointMass\n"
    )
    shutil.copy(POINT_MASS.partition(":")[0], "launched_point.py")
    own = f"{folder}/x.py:PointMass"
    theirs = Launch(folder / "out", "local", 2, "smoke", ("--env", own), Resources())
    theirs.path.mkdir()
    theirs.write()
    with pytest.raises(SettingError, match=r"was never named by you .* name it: --env"):
        program.main(["--resume", "out"])
    assert not ran.exists()
    assert program.main(["--resume", "out", "--", "--env", own]) == 0
    assert ran.exists()
    monkeypatch.setattr(named, "_named_now", set())  # as in a new process
    assert program.main(["--resume", "out"]) == 0
    (folder / "x.py").write_text("edited = True\n")
    monkeypatch.setattr(named, "_named_now", set())
    with pytest.raises(SettingError, match="has changed since you named it"):
        program.main(["--resume", "out"])
    assert len(planned) == 2


@pytest.mark.parametrize("kind", ["env", "curriculum", "agent", "relabelling"])
def test_no_other_way_to_choose_a_component_runs_code(
    kind: str, folder: Path, planned: list[Launch]
) -> None:
    ran = folder / "ran"
    (folder / "x.py").write_text(f"import pathlib\npathlib.Path({str(ran)!r}).touch()\n")
    words = ("--set", f"{kind}={folder}/x.py:Evil")
    theirs = Launch(folder / "out", "local", 2, "smoke", words, Resources())
    theirs.path.mkdir()
    theirs.write()
    with pytest.raises(SettingError, match=f"^set: {kind} is an option of its own, --{kind}$"):
        program.main(["--resume", "out"])
    assert not ran.exists()
    assert not planned


def test_a_launch_says_where_its_files_must_be(folder: Path, planned: list[Launch]) -> None:
    own = f"{folder}/gone.py:PointMass"
    launch = Launch(folder / "out", "local", 2, "smoke", ("--env", own), Resources())
    launch.path.mkdir()
    launch.write()
    line = f"^env: {folder}/gone.py is not there any more; a launch resumes with it there$"
    with pytest.raises(SettingError, match=line):
        program.main(["--resume", "out"])
    assert not planned


def test_a_launch_from_elsewhere_runs_no_tracker_that_was_not_named(
    folder: Path, planned: list[Launch], monkeypatch: pytest.MonkeyPatch
) -> None:
    ran, tracker = folder / "ran", folder / "elsewhere_tracker.py"
    tracker.write_text(
        f"import pathlib\npathlib.Path({str(ran)!r}).touch()\n{MY_TRACKER.read_text()}"
    )
    own = f"{tracker}:TextFile"
    theirs = Launch(folder / "out", "local", 2, "smoke", ("--track", own), Resources())
    theirs.path.mkdir()
    theirs.write()
    with pytest.raises(SettingError, match=r"^track: .* was never named by you .* --track"):
        program.main(["--resume", "out"])
    assert not ran.exists()
    assert program.main(["--resume", "out", "--", "--track", own]) == 0
    assert ran.exists()
    monkeypatch.setattr(named, "_named_now", set())  # as in a new process
    assert program.main(["--resume", "out"]) == 0
    assert len(planned) == 2


def test_a_neighbour_of_a_named_file_does_not_run_for_a_launch_once_it_was_edited(
    folder: Path, planned: list[Launch], monkeypatch: pytest.MonkeyPatch
) -> None:
    shutil.copy(POINT_MASS.partition(":")[0], "launched_neighbour.py")
    (folder / "x.py").write_text("from launched_neighbour import PointMass\n")
    words = [*SMOKE, "--env", f"{folder}/x.py:PointMass"]
    assert program.main(["--jobs", "2", "--out", "out", *words]) == 0
    (folder / "launched_neighbour.py").write_text("raise RuntimeError('it runs')\n")
    monkeypatch.setattr(named, "_named_now", set())
    with pytest.raises(SettingError, match=r"launched_neighbour.py has changed since you named"):
        program.main(["--resume", "out"])
    assert len(planned) == 1


def test_a_launch_from_elsewhere_connects_to_no_cluster_that_was_not_named(
    folder: Path, planned: list[Launch], monkeypatch: pytest.MonkeyPatch
) -> None:
    address = "ray://elsewhere:10001"
    theirs = Launch(folder / "out", "ray", 2, "smoke", (), Resources(address=address))
    theirs.path.mkdir()
    theirs.write()
    with pytest.raises(SettingError, match=f"address: .* if you trust it, .*--address {address}"):
        program.main(["--resume", "out"])
    monkeypatch.setattr(program, "_engine", lambda launch: None)
    assert program.main(["--resume", "out", "--address", address]) == 0
    assert planned[0].resources.address == address
    assert program._how_to_resume(planned[0]).endswith(f"/out --address {address}")


@pytest.mark.parametrize(
    "words",
    [
        ("--tyro-write-completion", "bash", "victim"),
        ("--tyro_print_completion", "bash"),
        ("--preset", "smoke", "-h"),
        ("--help",),
    ],
)
def test_a_launch_from_elsewhere_chooses_options_and_nothing_else(
    words: tuple[str, ...],
    folder: Path,
    planned: list[Launch],
    capsys: pytest.CaptureFixture[str],
) -> None:
    (folder / "victim").write_text("mine")
    theirs = Launch(folder / "out", "local", 2, "smoke", words, Resources())
    theirs.path.mkdir()
    theirs.write()
    with pytest.raises(SettingError, match="is no option here"):
        program.main(["--resume", "out"])
    assert (folder / "victim").read_text() == "mine"
    assert not capsys.readouterr().out
    assert not planned


@pytest.mark.parametrize(
    "part", ["attempts/1.jsonl", "logs/1.log", "parts", "launch.json", "slurm"]
)
def test_no_link_in_a_launch_leads_out_of_it(
    part: str, folder: Path, planned: list[Launch]
) -> None:
    launch = Launch(folder / "out", "local", 2, "smoke", (), Resources())
    launch.path.mkdir()
    launch.write()
    link, target = launch.path / part, folder / "theirs"
    if link.exists():
        link.rename(target)
    link.symlink_to(target)
    with pytest.raises(SettingError, match=f"{part} is a symbolic link"):
        program.main(["--resume", "out"])
    assert not planned


def by_attempt(order: Order) -> int:
    return Attempt(order).run()


def by_ray(order: Order) -> int:
    """As a task of Ray does, on a node that has this checkout elsewhere."""
    place, carried = str(Path(order.out).parents[1]), {"PYTHONPATH": str(ROOT)}
    return ray._make_attempt()(sys.executable, order.to_json(), carried, order.cwd, place)


@pytest.mark.parametrize("make", [by_attempt, by_ray])
def test_where_the_working_directory_is_not_there_nothing_of_the_launch_runs(
    make: Callable[[Order], int], folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    show = "import json, os; print(os.getcwd())"
    monkeypatch.setattr(Launch, "command", lambda *_: [sys.executable, "-c", show])
    launch, ran = Launch(folder / "out", "ray", 1, "smoke", (), Resources()), folder / "ran"
    launch.path.mkdir()
    launch.write()
    for theirs in ("json.py", "cgm_jax/__init__.py", "cgm_jax/launching/attempts.py"):
        (launch.path / theirs).parent.mkdir(parents=True, exist_ok=True)
        (launch.path / theirs).write_text(f"open({str(ran)!r}, 'w')\n")
    monkeypatch.chdir(launch.path)
    order = launch.order(1, None)
    assert make(replace(order, cwd=str(folder / "gone"))) == 0
    assert launch.log(1).read_text() == "/\n"
    assert not ran.exists()
    assert make(replace(order, cwd=str(folder))) == 0  # the user's own counts, where it is
    assert launch.log(1).read_text() == f"/\n{folder}\n"


def test_jobs_of_slurm_start_where_nobody_else_has_put_anything(folder: Path) -> None:
    (folder / "it's here").mkdir()
    for directory, entered in ((folder / "it's here", folder / "it's here"), (folder / "a", "/")):
        script = f"{slurm._entering(directory)}\npwd"
        shell = subprocess.run(["bash", "-c", script], capture_output=True, text=True, check=True)
        assert (shell.stdout, shell.stderr) == (f"{entered}\n", "")


def test_jobs_of_slurm_unpickle_nothing_that_lay_in_the_directory_before(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    submitit = pytest.importorskip("submitit")
    monkeypatch.setattr(submitit.SlurmExecutor, "affinity", staticmethod(lambda: 1))
    monkeypatch.setattr(slurm.shutil, "which", lambda program: f"/usr/bin/{program}")
    launch = Launch(folder / "out", "slurm", 2, "smoke", (), Resources())
    (launch.path / "slurm").mkdir(parents=True)
    (launch.path / "slurm" / "1_submitted.pkl").write_bytes(b"theirs")
    # As submitit has them, of an earlier launcher's jobs.
    (launch.path / "slurm" / ".submission_file_1.sh").symlink_to("1_submission.sh")
    with RunDirectory.claimed(launch.path, fresh=True):
        engines = [slurm.Slurm(launch.resources) for _ in range(2)]
        for engine in engines:
            engine.begin(launch)
    assert engines[0]._executor.parameters["setup"] == [slurm._entering(folder)]
    places = [engine._executor.folder for engine in engines]
    assert len({*places}) == 2
    for place in places:
        assert place.parent == launch.path / "slurm"
        assert stat.S_IMODE(place.stat().st_mode) == 0o700
        assert not list(place.iterdir())


def test_a_pipe_in_place_of_a_launch_is_not_read(folder: Path, planned: list[Launch]) -> None:
    (folder / "out").mkdir()
    os.mkfifo(folder / "out" / "launch.json")
    with pytest.raises(SettingError, match=r"launch.json is no ordinary file"):
        program.main(["--resume", "out"])
    assert not planned


ROWS = {
    "": "it has no row",
    "5\n": "TypeError",
    "{}\n": "KeyError: 'run'",
    "[" * 10**5 + "\n": "RecursionError",
    '{"run": "a", "epoch": 1, "success_rate": "high"}\n': "success_rate: 'high' in a row",
}


@pytest.mark.parametrize("text", ROWS)
def test_a_merged_launch_with_damaged_metrics_is_refused(folder: Path, text: str) -> None:
    launch = Launch(folder / "out", "local", 2, "smoke", (), Resources())
    launch.path.mkdir()
    launch.write()
    (launch.path / "config.json").write_text('{"format": 2, "groups": [], "parts": []}')
    (launch.path / "metrics.jsonl").write_text(text)
    with pytest.raises(SettingError, match=f"metrics.jsonl is damaged: .*{ROWS[text]}"):
        program.main(["--resume", "out"])


@pytest.mark.parametrize(
    "change",
    [
        {"format": 9},
        {"parts": "2"},
        {"sweep": "abc", "parts": None},
        {"resources": {}},
        {"on": "pbs"},
        {"parts": 10**9},
        {"sweep": [1]},
    ],
)
def test_a_damaged_launch_is_refused(
    folder: Path, planned: list[Launch], change: dict[str, Any]
) -> None:
    launch = Launch(folder / "out", "local", 2, "smoke", ("--preset", "smoke"), Resources())
    launch.path.mkdir()
    launch.write()
    path = launch.path / "launch.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), **change}))
    with pytest.raises(SettingError, match=r"launch.json is damaged"):
        program.main(["--resume", "out"])
    assert not planned
