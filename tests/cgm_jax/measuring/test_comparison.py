import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from cgm_jax.config.fields import SettingError
from cgm_jax.measuring import checkouts
from cgm_jax.measuring.child import MeasurementError
from cgm_jax.measuring.comparison import compare, measurement, parse_options
from cgm_jax.measuring.training_process import Cost
from tests.cgm_jax.measuring.stand_in import commit, git, write_checkout
from tests.cgm_jax.sweeps import ROOT


@pytest.fixture
def repository(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A repository whose last commit halves an epoch and doubles the start; where we run from."""
    root = tmp_path / "repository"
    write_checkout(root, start=0.15, epoch=0.2)
    commit(root, "Before")
    write_checkout(root, start=0.3, epoch=0.1)
    commit(root, "After")
    monkeypatch.setattr(checkouts, "HERE", root)
    monkeypatch.setattr(checkouts, "LIBRARIES", ())
    return root


def test_a_known_difference_is_found(repository: Path) -> None:
    options = ("--runs", "2")
    sides, comparisons = compare("HEAD~1", options, options, rounds=2, epochs=2)
    commits = [git(repository, "rev-parse", name).strip()[:8] for name in ("HEAD", "HEAD~1")]
    assert [side.checkout.commit for side in sides] == commits
    training, _, start, _ = comparisons
    assert training.name == "training, CPU ms"
    assert training.this == pytest.approx(0.1 * 1000 * 1000 / 100 / 2, rel=0.2)
    assert training.other == pytest.approx(0.2 * 1000 * 1000 / 100 / 2, rel=0.2)
    assert training.ratio.value == pytest.approx(0.5, rel=0.2)
    assert training.ratio.value == pytest.approx(training.this / training.other)
    assert start.name == "start, CPU s"
    assert start.this - start.other == pytest.approx(0.15, abs=0.08)
    assert start.ratio.value > 1.2
    for comparison in comparisons:
        assert comparison.ratio.low <= comparison.ratio.value <= comparison.ratio.high
    assert len(git(repository, "worktree", "list").splitlines()) == 1


def test_each_side_has_its_options(repository: Path) -> None:
    with pytest.raises(MeasurementError, match=r"sweep --fail 7 at .* exit code 7: error: told to"):
        compare("HEAD~1", (), ("--fail", "7"), rounds=2, epochs=1)
    assert len(git(repository, "worktree", "list").splitlines()) == 1


PROGRAM = """
import pathlib, sys
from cgm_jax.host.command_line import run_program
from cgm_jax.measuring import checkouts
checkouts.HERE, checkouts.LIBRARIES = pathlib.Path(sys.argv.pop(1)), ()
from cgm_jax.benchmark import main
run_program(main)
"""


def test_a_signal_leaves_nothing_behind(repository: Path, tmp_path: Path) -> None:
    temporary = tmp_path / "temporary"
    temporary.mkdir()
    arguments = ["--against", "HEAD~1", "--timed-epochs", "1", "--", "--runs", "1"]
    with subprocess.Popen(
        [sys.executable, "-c", PROGRAM, str(repository), *arguments],
        env={**os.environ, "TMPDIR": str(temporary), "PYTHONPATH": str(ROOT)},
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        assert process.stderr is not None
        line = process.stderr.readline()
        assert line.startswith("round 1 of 5: training 0."), line
        pids = _wait_for_pids(temporary)
        process.send_signal(signal.SIGTERM)
        assert process.wait(timeout=30) == 75
        assert process.stderr.read() == ""
    for pid in pids:
        with pytest.raises(ProcessLookupError):
            os.kill(pid, 0)
    assert list(temporary.iterdir()) == []
    assert len(git(repository, "worktree", "list").splitlines()) == 1


def _wait_for_pids(temporary: Path) -> list[int]:
    """Processes of the second round, once there are both."""
    while True:
        pids = [path.read_text() for path in temporary.rglob("sweep/pid")]
        if len(pids) == 2 and all(pids):
            return [int(pid) for pid in pids]
        time.sleep(0.05)


@pytest.mark.slow
def test_a_commit_costs_as_much_as_itself(tmp_path: Path) -> None:
    clone = tmp_path / "clone"  # of what is committed, whatever else is in the checkout
    git(ROOT, "clone", "--quiet", str(ROOT), str(clone))
    sweep = ["--preset", "smoke", "--epochs", "9", "--cycles-per-epoch", "40", "--seeds", "1"]
    arguments = ["--against", "HEAD", "--repeats", "2", "--timed-epochs", "4", "--", *sweep]
    result = subprocess.run(
        [sys.executable, "-m", "cgm_jax.benchmark", *arguments],
        capture_output=True,
        text=True,
        cwd=clone,
        env={**os.environ, "PYTHONPATH": str(clone), "COLUMNS": "80"},
        check=False,
    )
    assert result.returncode == 0, result.stderr
    for name in ("training, CPU ms", "start, CPU s"):
        found = re.search(rf"{name} .*│ ([\d.]+) │ ([\d.]+)-([\d.]+) +│ 1\.", result.stdout)
        assert found, result.stdout
        ratio, low, high = map(float, found.groups())
        assert 0.5 <= ratio <= 2.0
        assert low <= ratio <= high


def test_start_and_training_by_hand() -> None:
    # Epochs of 1,000 steps in 2 s and 3 CPU seconds; the start adds 10 and 12 seconds.
    first = Cost(wall_s=12.0, cpu_s=15.0, env_steps=1000)
    later = [Cost(wall_s=1.5, cpu_s=3.0, env_steps=1000), Cost(2.5, 3.0, 1000)]
    taken = measurement(first, later, runs=4)
    assert taken.training_wall == pytest.approx(500.0)
    assert taken.training_cpu == pytest.approx(750.0)
    assert taken.start_wall == pytest.approx(10.0)
    assert taken.start_cpu == pytest.approx(12.0)


def test_epochs_that_the_clock_cannot_tell_are_refused() -> None:
    with pytest.raises(MeasurementError, match="too short"):
        measurement(Cost(1.0, 1.0, 100), [Cost(0.005, 0.0, 100)], runs=1)


def test_options_are_split_as_in_a_shell() -> None:
    text = "--preset cpu --env 'my file.py:Env'"
    assert parse_options("against_options", text) == ("--preset", "cpu", "--env", "my file.py:Env")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("--out here", "--out is for the benchmark"),
        ("--resume=here", "--resume=here is for the benchmark"),
        ("--env 'push", "no closing quotation"),
    ],
)
def test_options_that_cannot_be_given_are_refused(text: str, said: str) -> None:
    with pytest.raises(SettingError, match=f"^against_options: {said}"):
        parse_options("against_options", text)
