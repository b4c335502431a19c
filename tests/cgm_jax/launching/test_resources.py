"""What a machine has is shared out among parts; other machines are told what they need."""

import itertools
import json
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from cgm_jax.config.fields import SettingError
from cgm_jax.launching import local, ray
from cgm_jax.launching.directory import Launch, Resources, carried_environment
from cgm_jax.launching.local import Local
from cgm_jax.launching.slurm import sbatch_options
from cgm_jax.launching.supervision import Ended


@pytest.mark.parametrize(
    ("parts", "resources", "rooms", "cores"),
    [
        (2, Resources(), 2, 4),
        (3, Resources(), 3, 2),
        (99, Resources(), 8, 1),
        (99, Resources(cores=3), 2, 3),
        (1, Resources(cores=1), 1, 1),
        (99, Resources(gpus=1), 4, 2),
        (99, Resources(gpus=2, cores=1), 2, 1),
        (99, Resources(gpus=1, cores=4), 2, 4),
        (2, Resources(gpus=0), 2, 4),
        (99, Resources(memory=5), 3, 2),
        (99, Resources(cores=1, memory=1), 8, 1),
    ],
)
def test_a_machine_of_eight_cores_four_gpus_and_16_gib_is_shared_out(
    monkeypatch: pytest.MonkeyPatch, parts: int, resources: Resources, rooms: int, cores: int
) -> None:
    monkeypatch.setattr(local, "free_memory", lambda: 16 * 2**30)
    monkeypatch.setattr(local, "available_cores", lambda: 8)
    gpus = ["0", "1", "2", "3"] if resources.gpus is not None else []
    monkeypatch.setattr(local, "visible_gpus", lambda: gpus)
    monkeypatch.delenv("JAX_PLATFORMS", raising=False)
    engine = Local(parts, resources)
    assert (engine.rooms, engine.room(), engine.cores) == (rooms, rooms, cores)


def test_more_memory_than_there_is_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(local, "free_memory", lambda: 16 * 2**30)
    with pytest.raises(SettingError, match=r"^memory: 17 GiB are more than the 16\.0 free here$"):
        Local(2, Resources(memory=17))


@pytest.mark.parametrize(("memory", "told"), [(None, None), (1.5, "1536")])
def test_ray_tells_parts_how_much_memory_they_have(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, memory: float | None, told: str | None
) -> None:
    attempts: list[Any] = []
    attempt = SimpleNamespace(remote=lambda *arguments: attempts.append(arguments))
    fake = SimpleNamespace(init=lambda **_: None, remote=lambda **_: lambda _: attempt)
    monkeypatch.setitem(sys.modules, "ray", fake)
    launch = Launch(tmp_path, "ray", 1, "smoke", (), Resources(memory=memory))
    engine = ray.Ray(launch.resources)
    engine.begin(launch)
    engine.start([1])
    ((_, order, carried, *_),) = attempts
    assert carried.get("CGM_JAX_MEMORY_MIB") == told
    assert json.loads(order)["environment"].get("CGM_JAX_MEMORY_MIB") == told


class RayError(Exception):
    """As Ray's: with what a task has raised as its cause."""

    def __init__(self, cause: Exception) -> None:
        super().__init__(str(cause))
        self.cause = cause


def test_a_ray_node_without_the_directory_costs_attempts_and_not_the_launch(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    done: dict[str, Any] = {}

    def get(task: str) -> int:
        if isinstance(done[task], Exception):
            raise done[task]
        return done[task]

    numbers = itertools.count()
    fake = SimpleNamespace(
        init=lambda **_: None,
        remote=lambda **_: lambda _: SimpleNamespace(remote=lambda *_: f"task {next(numbers)}"),
        wait=lambda tasks, **_: ([task for task in tasks if task in done], []),
        get=get,
        exceptions=SimpleNamespace(RayError=RayError),
    )
    monkeypatch.setitem(sys.modules, "ray", fake)
    launch = Launch(tmp_path, "ray", 2, "smoke", (), Resources())
    engine, missing = ray.Ray(launch.resources), RayError(FileNotFoundError("/x is not there on n"))
    engine.begin(launch)
    engine.start([1, 2])
    done["task 0"] = missing
    assert engine.ended() == {1: Ended(None)}  # the other may have found a better node
    assert capsys.readouterr().err == "on: /x is not there on n\n"
    engine.start([1])
    done |= {"task 1": missing, "task 2": 0}
    assert engine.ended() == {2: Ended(None), 1: Ended(0)}
    engine.begin(launch)
    engine.start([1, 2])
    done |= {"task 3": missing, "task 4": missing}
    with pytest.raises(SettingError, match=r"^on: /x is not there on n$"):
        engine.ended()


def test_gpus_are_given_out_and_taken_back(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("JAX_PLATFORMS", raising=False)
    monkeypatch.setenv("CUDA_VISIBLE_DEVICES", "GPU-a,GPU-b")
    monkeypatch.setattr(local, "available_cores", lambda: 2)
    show = "import os; print(os.environ['CUDA_VISIBLE_DEVICES'], os.environ['CGM_JAX_MEMORY_MIB'])"
    monkeypatch.setattr(Launch, "command", lambda *_: [sys.executable, "-I", "-c", show])
    launch = Launch(tmp_path, "local", 3, "smoke", (), Resources(memory=1.5))
    launch.write()
    engine = Local(3, launch.resources)
    engine.begin(launch)
    engine.start([1, 2])
    assert engine.room() == 0
    ended: dict[int, Any] = {}
    while len(ended) < 2:
        ended |= engine.ended()
    assert engine.room() == 2
    seen = sorted(launch.log(part).read_text() for part in (1, 2))
    assert seen == ["GPU-a 1536\n", "GPU-b 1536\n"]


def test_sbatch_takes_what_cannot_do_harm() -> None:
    assert sbatch_options(["partition=gpu,long", "gres=gpu:a100:2", "exclusive"]) == {
        "partition": "gpu,long",
        "gres": "gpu:a100:2",
        "exclusive": True,
    }
    for text in ("output=/home/me/.bashrc", "wrap=rm", "comment=a\nrm -r x", "comment=$(rm)"):
        with pytest.raises(SettingError, match=r"^sbatch: "):
            sbatch_options([text])


def test_other_machines_get_what_they_need(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PYTHONPATH", "/code")
    monkeypatch.setenv("CUDA_VISIBLE_DEVICES", "0")
    monkeypatch.delenv("XDG_STATE_HOME", raising=False)
    monkeypatch.setenv("HOME", "/home/me")
    carried = carried_environment()
    assert carried["PYTHONPATH"] == "/code"
    assert carried["XDG_STATE_HOME"] == "/home/me/.local/state"  # the list of allowed files
    assert "CUDA_VISIBLE_DEVICES" not in carried
