import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib import pyplot as plt

from cgm_jax.config.fields import SettingError
from cgm_jax.storage.lock import InUseError, locked
from experiments.markdown import NOT_YET
from experiments.other_programs import compare, figure, our_run, report_tables
from experiments.other_programs.arms import ARMS, NAMES, OURS
from experiments.table import read_table, write_table

CURVE = "env_steps,cpu_s,success_rate\n20000,10.0,0.1\n40000,20.0,0.9\n"


@pytest.fixture
def commands(monkeypatch: pytest.MonkeyPatch) -> list[Sequence[str]]:
    """The commands of runs, which only write a curve."""
    called: list[Sequence[str]] = []

    def run(command: Sequence[str], **_: Any) -> subprocess.CompletedProcess[str]:
        called.append(command)
        path = Path(command[-1])
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(CURVE)
        fails = "sb3_sac" in path.name and "fails" in str(path)
        return subprocess.CompletedProcess(command, int(fails), "", "no torch")

    monkeypatch.setattr(subprocess, "run", run)
    monkeypatch.setattr(compare, "provenance", lambda *_: {"commit": "abc", "machine": "here"})
    return called


def test_each_missing_run_is_trained_once_and_noted(
    tmp_path: Path, commands: list[Sequence[str]]
) -> None:
    python = tmp_path / "python"
    python.touch()
    words = ["--python", str(python), "--out", str(tmp_path / "out"), "--cpu-seconds", "60"]
    assert compare.main([*words, "--tasks", "push"]) == 0
    assert len(commands) == len(NAMES)
    assert compare.main([*words, "--tasks", "push", "--seeds", "0", "1", "1"]) == 0
    assert len(commands) == 2 * len(NAMES)

    rows = read_table(tmp_path / "out" / "runs.csv")
    assert sorted((row["arm"], row["seed"]) for row in rows) == sorted(
        (arm, seed) for arm in NAMES for seed in "01"
    )
    assert {(row["task"], row["commit"], row["machine"], row["cpu_seconds"]) for row in rows} == {
        ("push", "abc", "here", "60.0")
    }
    for command in commands[: len(NAMES)]:
        arm = command[-5]
        assert list(command[-4:-1]) == ["push", "0", "60.0"]
        program = "our_run" if arm in OURS else "sb3_run"
        assert f"experiments.other_programs.{program}" in command
        assert (str(python) in command) == (arm in ARMS)


def test_two_programs_do_not_write_into_one_directory(
    tmp_path: Path, commands: list[Sequence[str]]
) -> None:
    with locked(tmp_path), pytest.raises(InUseError):
        compare.main(["--arms", "cgm_jax", "--tasks", "push", "--out", str(tmp_path)])
    assert not commands


def test_a_run_ends_once_the_program_that_started_it_is_gone() -> None:
    code = """
import os, time
ready, written = os.pipe()
if os.fork():
    os.read(ready, 1)
else:
    from experiments.other_programs.curve import PARENT, is_wanted
    print(is_wanted(), flush=True)
    os.write(written, b".")
    for _ in range(3000):
        if os.getppid() != PARENT:
            break
        time.sleep(0.01)
    print(is_wanted(), flush=True)
"""
    result = subprocess.run(
        [sys.executable, "-c", code],
        cwd=compare.ROOT,
        capture_output=True,
        text=True,
        check=True,
        timeout=60,
    )
    assert result.stdout.split() == ["True", "False"]


def test_a_short_trial_does_not_replace_a_long_one(
    tmp_path: Path, commands: list[Sequence[str]]
) -> None:
    words = ["--arms", "cgm_jax", "--tasks", "push", "--out", str(tmp_path)]
    for _ in range(2):
        assert compare.main([*words, "--cpu-seconds", "7200"]) == 0
    with pytest.raises(SettingError, match=r"cpu_seconds: .* holds runs of 7200; name another"):
        compare.main([*words, "--cpu-seconds", "60"])
    assert len(commands) == 1
    (row,) = read_table(tmp_path / "runs.csv")
    assert row["cpu_seconds"] == "7200.0"


def test_a_run_that_fails_says_why_and_costs_the_others_nothing(
    tmp_path: Path, commands: list[Sequence[str]], capsys: pytest.CaptureFixture[str]
) -> None:
    out, python = tmp_path / "fails", tmp_path / "python"
    python.touch()
    words = ["--arms", "sb3_sac", "cgm_jax", "--python", str(python), "--out", str(out)]
    assert compare.main([*words, "--tasks", "push"]) == 1
    assert "error: sb3_sac-push-0 has failed:\nno torch" in capsys.readouterr().err
    assert len(commands) == 2
    assert [path.name for path in (out / "curves").glob("*.csv")] == ["cgm_jax-push-0.csv"]
    assert compare.main([*words, "--tasks", "push"]) == 1
    assert len(commands) == 3  # the one that failed, again


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--arms", "ppo"], "arms: 'ppo' is none of cgm_jax, cgm_jax_plain, sb3_sac"),
        (["--tasks", "slide"], "tasks: 'slide' is none of push, pick_and_place"),
        (["--cpu-seconds", "0"], "cpu_seconds: 0 is not above 0"),
        (["--seeds", "0", "-1"], "seeds: -1 is below 0"),
        (["--python", "nowhere"], "python: there is no nowhere; make compare-sb3 builds it"),
    ],
)
def test_what_cannot_be_compared_is_refused(words: list[str], message: str) -> None:
    with pytest.raises(SettingError, match=message):
        compare.main(words)


def test_the_figure_shows_each_seed_by_seconds_and_by_steps(tmp_path: Path) -> None:
    (tmp_path / "curves").mkdir()
    runs = []
    for arm, seed in (("cgm_jax", 0), ("cgm_jax", 1), ("sb3_sac", 0), ("sb3_ddpg", 0)):
        runs.append({"arm": arm, "task": "push", "seed": seed, "cpu_seconds": 60})
        if arm != "sb3_ddpg":  # its curve is gone
            (tmp_path / "curves" / f"{arm}-push-{seed}.csv").write_text(CURVE)
    (tmp_path / "curves" / "sb3_sac-push-2.csv").write_text(CURVE)  # never noted
    write_table(tmp_path / "runs.csv", runs)
    curves = figure.curves_in(tmp_path)
    assert {key: len(seeds) for key, seeds in curves.items()} == {
        ("push", "cgm_jax"): 2,
        ("push", "sb3_sac"): 1,
    }
    _, panel = plt.subplots()
    figure.draw_arm(panel, curves["push", "cgm_jax"], "cpu_s", "cgm_jax")
    first, second = panel.get_lines()
    assert first.get_label() == "this program, preset cpu (HER, stages, CGM), two seeds"
    assert str(second.get_label()).startswith("_")
    np.testing.assert_array_equal(first.get_xydata(), [[10.0, 0.1], [20.0, 0.9]])
    plt.close()
    assert figure.draw(tmp_path).stat().st_size > 10_000


def test_without_a_curve_there_is_no_figure(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="there is no curve"):
        figure.draw(tmp_path)


@pytest.mark.slow
def test_a_run_of_ours_may_end_with_its_preset(tmp_path: Path) -> None:
    path = tmp_path / "curve.csv"
    code = "from experiments.other_programs.our_run import main; from pathlib import Path; "
    code += f"raise SystemExit(main('cgm_jax', 'reach', 0, 1e9, Path({str(path)!r}), 'smoke'))"
    subprocess.run([sys.executable, "-c", code], cwd=compare.ROOT, check=True)
    assert [row["env_steps"] for row in read_table(path)] == ["400", "800"]


@pytest.mark.slow
def test_a_run_of_ours_ends_after_the_evaluation_that_finds_its_seconds_used_up(
    tmp_path: Path,
) -> None:
    words = ["-m", our_run.__name__, "cgm_jax_plain", "push", "0", "1", str(tmp_path / "curve.csv")]
    result = subprocess.run([sys.executable, *words], cwd=compare.ROOT, check=False)
    assert result.returncode == 0
    (row,) = read_table(tmp_path / "curve.csv")
    assert row["env_steps"] == "20000"
    assert float(row["cpu_s"]) > 1
    assert 0 <= float(row["success_rate"]) <= 1


def test_the_table_says_when_90_percent_was_held(tmp_path: Path) -> None:
    (tmp_path / "curves").mkdir()
    rates = {"cgm_jax-push-0": (0.0, 0.86, 0.9, 0.96), "sb3_sac-push-0": (0.0, 0.0, 0.04, 0.02)}
    for name, of_run in rates.items():
        rows = [
            {"env_steps": 20000 * i, "cpu_s": 10.4 * i, "success_rate": rate}
            for i, rate in enumerate(of_run, start=1)
        ]
        write_table(tmp_path / "curves" / f"{name}.csv", rows)
    noted = [
        {"arm": arm, "task": "push", "seed": 0, "cpu_seconds": 7200}
        for arm in ("sb3_sac", "cgm_jax")
    ]
    write_table(tmp_path / "runs.csv", noted)
    held = [report_tables.held_by_program(arm, "push", tmp_path) for arm in ("cgm_jax", "sb3_sac")]
    assert held == ["one of one seed", "none of one seed"]
    assert report_tables.held_by_program("sb3_ddpg", "push", tmp_path) == NOT_YET
    ours, theirs = report_tables.other_programs(tmp_path).rows
    assert list(ours[2:]) == ["0", "42", "80", "90.7", "80", "42"]  # (0.86 + 0.9 + 0.96) / 3
    assert list(theirs[1:]) == [
        *("Stable-Baselines3, SAC + HER", "0", "never", "", "2", "80", "42"),
    ]
