"""Systems that lack something, and programs that are run inside others."""

import ast
import os
import shlex
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

import cgm_jax
from cgm_jax.host.session import new_directory
from cgm_jax.machine.commands import shell_command
from tests.cgm_jax.sweeps import POINT_MASS, ROOT

# No fcntl, no home, no entry in passwd, plain ASCII output, three signals and poll missing.
BARE = """
import pwd, select, signal, sys
def no_entry(_): raise KeyError(_)
sys.modules["fcntl"] = None
pwd.getpwuid = no_entry
del select.poll, signal.SIGHUP, signal.SIGUSR1, signal.SIGUSR2
from cgm_jax.host.command_line import run_program
from cgm_jax.sweep import main
run_program(main)
"""


def bare_environment(**more: str) -> dict[str, str]:
    kept = {name: value for name, value in os.environ.items() if name != "HOME"}
    plain = {"PYTHONIOENCODING": "ascii", "LANG": "C", "LC_ALL": "C", "PYTHONPATH": str(ROOT)}
    return {**kept, **plain, **more}


@pytest.mark.slow
def test_a_bare_system_trains_stops_and_resumes_by_the_printed_command(tmp_path: Path) -> None:
    out = tmp_path / "läufe mit 'space'"
    options = ["--preset", "smoke", "--env", POINT_MASS, "--epochs", "4000", "--out", str(out)]
    with subprocess.Popen(
        [sys.executable, "-c", BARE, *options],
        stderr=subprocess.PIPE,
        text=True,
        cwd=tmp_path,
        env=bare_environment(),
    ) as process:
        assert process.stderr is not None
        for line in process.stderr:
            if line.startswith("epoch 2:"):
                break
        process.send_signal(signal.SIGTERM)
        text = process.stderr.read()
        assert process.wait(timeout=60) == 75, text
    assert text.isascii()
    (printed,) = (
        line.partition("to resume: ")[2] for line in text.splitlines() if "to resume" in line
    )
    with subprocess.Popen(
        [*shlex.split(printed.encode().decode("unicode_escape"))],
        stderr=subprocess.PIPE,
        text=True,
        cwd="/",
        env={**os.environ, "PYTHONPATH": str(ROOT)},
    ) as process:
        assert process.stderr is not None
        said = line = ""
        for line in process.stderr:
            said += line
            if line.startswith("epoch "):
                break
        process.send_signal(signal.SIGTERM)
        process.stderr.read()
        assert process.wait(timeout=60) == 75, said
    assert "resuming where it was stopped" in said
    assert not line.startswith("epoch 1:")


def test_printed_commands_are_quoted_and_absolute(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    command = shell_command("cgm_jax.sweep", "--resume", Path("my runs/$HOME"))
    print_words = f'for word in {command}; do echo "$word"; done'
    shown = subprocess.run(print_words, shell=True, capture_output=True, text=True, check=True)
    assert shown.stdout.splitlines() == [
        *(sys.executable, "-m", "cgm_jax.sweep", "--resume"),
        f"{tmp_path}/my runs/$HOME",
    ]


def test_directories_named_for_one_second_do_not_collide(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    if time.time() % 1 > 0.9:
        time.sleep(0.2)
    made = [new_directory("smoke") for _ in range(3)]
    assert len(set(made)) == 3
    assert [path.name.removeprefix(made[0].name) for path in made] == ["", "-2", "-3"]
    assert all((tmp_path / path).is_dir() for path in made)


@pytest.mark.slow
def test_three_trainings_started_at_once_without_a_name_get_three_directories(
    tmp_path: Path,
) -> None:
    command = [sys.executable, "-m", "cgm_jax.train", "--preset", "smoke", "--epochs", "1"]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    started = [
        subprocess.Popen(
            command,
            cwd=tmp_path,
            env=environment,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
        )
        for _ in range(3)
    ]
    errors = [process.communicate(timeout=300)[1] for process in started]
    assert [process.returncode for process in started] == [0, 0, 0], errors
    configs = sorted(tmp_path.glob("runs/*/config.json"))
    assert len(configs) == 3
    assert all((path.parent / "policies").iterdir() for path in configs)


QUIET = """
import sys
import cgm_jax.{first}
import cgm_jax.results.figures
assert "matplotlib.pyplot" not in sys.modules
print("quiet")
"""


@pytest.mark.parametrize("first", ["storage.policies", "loop.training"])
def test_imports_say_nothing_and_choose_no_backend(first: str) -> None:
    program = [sys.executable, "-c", QUIET.format(first=first)]
    result = subprocess.run(program, capture_output=True, text=True, cwd=ROOT, check=False)
    assert (result.stdout, result.stderr) == ("quiet\n", "")


SILENCED = {"envs/gymnasium", "envs/physics", "loop"}
"""Rooms whose first import imports MJX without its remarks."""


def test_whatever_imports_brax_is_in_a_room_that_is_quiet() -> None:
    root = Path(cgm_jax.__file__).parent
    for path in (*root.rglob("*.py"), *(root / "envs").rglob("*.py")):  # a link, in a checkout
        imported = set()
        for node in ast.parse(path.read_text()).body:  # at the top of the file only
            if isinstance(node, ast.ImportFrom) and node.module:
                imported |= {node.module, *(f"{node.module}.{name.name}" for name in node.names)}
            elif isinstance(node, ast.Import):
                imported |= {name.name for name in node.names}
        if path.name == "quiet_import.py":
            continue
        if any(name.split(".")[0] == "brax" or name == "mujoco.mjx" for name in imported):
            assert str(path.parent.relative_to(root)) in SILENCED, path
    for room in SILENCED:
        assert "quiet_import" in (root / room / "__init__.py").read_text()


def test_a_device_that_is_not_there_is_one_line(tmp_path: Path) -> None:
    out = tmp_path / "out"
    command = [sys.executable, "-m", "cgm_jax.train", "--preset", "smoke", "--out", str(out)]
    environment = {**os.environ, "JAX_PLATFORMS": "cuda", "CUDA_VISIBLE_DEVICES": ""}
    process = subprocess.run(command, capture_output=True, text=True, env=environment, cwd=ROOT)
    assert process.returncode == 2
    (line,) = process.stderr.splitlines()
    assert line.startswith("error: JAX_PLATFORMS: JAX finds no device for 'cuda'")
    assert not out.exists()
