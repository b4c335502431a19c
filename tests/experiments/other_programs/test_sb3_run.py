"""Stable-Baselines3's arms, in the environment that `make compare-sb3` builds; `make test-sb3`."""

import json
import subprocess
from pathlib import Path

import pytest

from experiments.other_programs.compare import ROOT, CompareOptions
from experiments.table import read_table

PYTHON = CompareOptions().python
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not PYTHON.is_file(), reason="make test-sb3 builds what it needs"),
]

LEARN = """
import json, sys
from experiments.other_programs.arms import ARMS
from experiments.other_programs.sb3_run import learner

model = learner(ARMS[sys.argv[1]], sys.argv[2], 0)
model.learn(int(sys.argv[3]))
in_the_air = model.env.envs[0].unwrapped.target_in_the_air
print(json.dumps([
    type(model).__name__, model.n_envs, model.num_timesteps, model._n_updates, in_the_air,
]))
"""


@pytest.mark.parametrize(
    ("arm", "task", "steps", "expected"),
    [
        ("sb3_sac", "push", 1020, ["SAC", 1, 1020, 20, False]),
        ("sb3_ddpg", "pick_and_place", 1020, ["DDPG", 1, 1020, 20, True]),
        # Whole cycles of 800 steps: none learns before step 1,000, the second and third do.
        ("sb3_ddpg_our_ratio", "push", 2400, ["DDPG", 16, 2400, 80, False]),
    ],
)
def test_an_arm_takes_its_steps_and_updates(
    arm: str, task: str, steps: int, expected: list[object]
) -> None:
    command = [str(PYTHON), "-c", LEARN, arm, task, str(steps)]
    result = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    assert json.loads(result.stdout.splitlines()[-1]) == expected


def test_a_run_ends_with_an_evaluation_once_its_seconds_are_used_up(tmp_path: Path) -> None:
    out = tmp_path / "curve.csv"
    words = ["experiments.other_programs.sb3_run", "sb3_sac", "push", "0", "1e-6", str(out)]
    subprocess.run([str(PYTHON), "-m", *words], cwd=ROOT, capture_output=True, check=True)
    (row,) = read_table(out)
    assert row["env_steps"] == "1"
    assert float(row["cpu_s"]) > 1
    assert 0 <= float(row["success_rate"]) <= 0.5  # a tenth of the goals begin achieved
