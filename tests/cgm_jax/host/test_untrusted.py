"""Run directories that somebody else may have made: the README's promise, tried."""

import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from cgm_jax import evaluate, report, sweep
from cgm_jax.config import allowed, named
from cgm_jax.config.fields import SettingError
from cgm_jax.config.grid import build_groups
from cgm_jax.storage.layout import CONFIG
from cgm_jax.storage.run_directory import RunDirectory
from tests.cgm_jax.sweeps import ROOT

CODE = """from pathlib import Path

Path(__file__).with_name("ran").touch()
from tests.cgm_jax.own_environments import Base as F
"""


@pytest.fixture(autouse=True)
def nothing_named(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    for names in ("_named_now", "_from_config", "_texts_named_now", "_texts_from_config"):
        monkeypatch.setattr(named, names, set())


@pytest.fixture
def untrusted(tmp_path: Path) -> Path:
    """A directory from elsewhere, whose config names code that it brings along."""
    out = tmp_path / "untrusted"
    with RunDirectory.claimed(out, fresh=True) as directory:
        directory.config.write(build_groups("smoke", {}), "smoke", "cpu")
    (out / "figures" / "x.py").write_text(CODE)
    (out / "policies" / "a.npz").touch()
    return out


def change_runs(out: Path, **values: Any) -> None:
    config = json.loads((out / CONFIG).read_text())
    for number, run in enumerate(config["groups"][0]["runs"]):
        run |= {"name": f"run{number}", **values}
    (out / CONFIG).write_text(json.dumps(config))


READERS: dict[str, Callable[[Path], int]] = {
    "evaluate": lambda out: evaluate.main([str(out)]),
    "evaluate a run": lambda out: evaluate.main([str(out), "--run", "run0"]),
    "sweep --resume": lambda out: sweep.main(["--resume", str(out)]),
    "sweep --out": lambda out: sweep.main(["--preset", "smoke", "--out", str(out)]),
}


@pytest.mark.parametrize("reader", READERS)
@pytest.mark.parametrize("kind", ["env", "curriculum", "agent", "relabelling"])
def test_code_that_a_config_names_does_not_run(kind: str, reader: str, untrusted: Path) -> None:
    text = f"{untrusted / 'figures' / 'x.py'}:F"
    change_runs(untrusted, **{kind: text})
    with pytest.raises(SettingError) as refusal:
        READERS[reader](untrusted)
    assert str(refusal.value) == (
        f"{kind}: {text.removesuffix(':F')} was never named by you on this machine, so it is not "
        f"run; if you trust it, name it: --{kind} {text}"
    )
    assert not (untrusted / "figures" / "ran").exists()


@pytest.mark.parametrize("reader", READERS)
def test_a_module_for_gymnasium_that_a_config_names_is_not_imported(
    reader: str, untrusted: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(str(untrusted / "figures"))
    monkeypatch.delitem(sys.modules, "x", raising=False)  # another test's
    change_runs(untrusted, env="gymnasium:x:X-v0")
    with pytest.raises(SettingError) as refusal:
        READERS[reader](untrusted)
    assert str(refusal.value) == (
        f"env: {untrusted / 'figures' / 'x.py'} was never named by you on this machine, so it is "
        "not run; if you trust it, name it: --env gymnasium:x:X-v0"
    )
    assert not (untrusted / "figures" / "ran").exists()


def test_another_interpreter_runs_nothing_that_only_a_config_names(
    untrusted: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(str(untrusted / "figures"))
    monkeypatch.delitem(sys.modules, "x", raising=False)  # another test's
    monkeypatch.setenv("CGM_JAX_GYMNASIUM_PYTHON", sys.executable)
    monkeypatch.setattr(allowed, "remembers", lambda path, data: True)
    change_runs(untrusted, env="gymnasium:x:X-v0")
    with pytest.raises(SettingError, match=r"^env: name it, since CGM_JAX_"):
        sweep.main(["--resume", str(untrusted)])
    assert not (untrusted / "figures" / "ran").exists()


def test_modules_beside_the_directory_do_not_run_either(
    untrusted: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(untrusted / "figures")
    monkeypatch.syspath_prepend("")  # as `python -m` has it
    change_runs(untrusted, env="x:F")
    with pytest.raises(SettingError, match=r"env: .*x.py was never named by you on this machine"):
        evaluate.main([str(untrusted)])
    assert not (untrusted / "figures" / "ran").exists()


@pytest.mark.parametrize("reader", READERS)
def test_names_of_runs_do_not_lead_out_of_the_directory(reader: str, untrusted: Path) -> None:
    before = sorted(untrusted.parent.rglob("*"))
    change_runs(untrusted, name="../../../escape")
    with pytest.raises(SettingError, match=r"config.json is damaged: run: '\.\./\.\./\.\./escape'"):
        READERS[reader](untrusted)
    assert sorted(untrusted.parent.rglob("*")) == before


def test_naming_the_file_beside_the_directory_is_accepted_and_remembered(untrusted: Path) -> None:
    text = f"{untrusted / 'figures' / 'x.py'}:F"
    change_runs(untrusted, env=text)
    (untrusted / "policies" / "a.npz").rename(untrusted / "policies" / "run0.npz")
    for named_now in (["--env", text], []):
        with pytest.raises(SettingError, match=r"run0.npz is no file of arrays"):
            evaluate.main([str(untrusted), *named_now])
        assert (untrusted / "figures" / "ran").exists()
        named._named_now.clear()
    with (untrusted / "figures" / "x.py").open("a") as file:
        file.write("# edited\n")
    with pytest.raises(SettingError, match=r"x.py has changed since you named it on this machine"):
        evaluate.main([str(untrusted)])


@pytest.mark.parametrize("program", [evaluate, report])
def test_a_config_beyond_all_measure_is_not_read(
    program: Any, untrusted: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with (untrusted / CONFIG).open("wb") as file:
        file.truncate(6 * 2**30)
    read = Path.read_bytes

    def read_small(path: Path) -> bytes:
        assert path.stat().st_size < 2**30
        return read(path)

    monkeypatch.setattr(Path, "read_bytes", read_small)
    with pytest.raises(SettingError, match="it has more than 268,435,456 bytes"):
        program.main([str(untrusted)])


def test_the_refusal_is_one_line_and_exit_code_2(untrusted: Path) -> None:
    change_runs(untrusted, env=f"{untrusted / 'figures' / 'x.py'}:F")
    result = subprocess.run(
        [sys.executable, "-m", "cgm_jax.sweep", "--resume", str(untrusted)],
        capture_output=True,
        text=True,
        cwd=ROOT,
        env={"PATH": os.environ["PATH"], "PYTHONPATH": str(ROOT), "JAX_PLATFORMS": "cpu"},
        check=False,
    )
    assert result.returncode == 2, result.stderr
    assert result.stderr.startswith("error: env: ")
    assert result.stderr.count("\n") == 1
    assert not (untrusted / "figures" / "ran").exists()
