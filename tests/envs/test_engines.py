"""MJX against C MuJoCo, in processes of their own: MJX on a CPU needs its own compiler flag."""

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from cgm_jax.envs.physics.mjx import CPU_FLAG

ROOT = Path(__file__).parents[2]
TASKS = ("push", "pick_and_place")


@pytest.fixture(scope="module")
def figures() -> dict[str, dict[str, Any]]:
    """What tests/envs/engine_checks.py finds out, both tasks side by side."""
    processes = {
        task: subprocess.Popen(
            [sys.executable, "-m", "tests.envs.engine_checks", task, "mjx"],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            cwd=ROOT,
            env={**os.environ, "XLA_FLAGS": CPU_FLAG},
        )
        for task in TASKS
    }
    results = {}
    for task, process in processes.items():
        output, errors = process.communicate(timeout=580)
        assert process.returncode == 0, errors
        results[task] = json.loads(output)
    return results


@pytest.mark.slow
@pytest.mark.parametrize("task", TASKS)
def test_free_motion_under_fifty_actions_agrees_to_a_tenth_of_a_millimetre(
    task: str, figures: dict[str, dict[str, Any]]
) -> None:
    assert figures[task]["moved"] > 0.04  # metres, along every axis of every episode
    assert figures[task]["lowest"] > 0.42  # nothing was touched
    assert figures[task]["strayed"] < 1e-4


@pytest.mark.slow
@pytest.mark.parametrize("task", TASKS)
def test_controllers_written_by_hand_do_the_same_on_both(
    task: str, figures: dict[str, dict[str, Any]]
) -> None:
    assert figures[task]["success"] >= 0.95
    assert figures[task]["same_outcome"] >= 0.95
    if task == "pick_and_place":
        assert figures[task]["lifted"] > 0.8  # of all goals, those over 2.5 cm


@pytest.mark.slow
@pytest.mark.parametrize("task", TASKS)
def test_adversarial_actions_do_not_break_mjx(
    task: str, figures: dict[str, dict[str, Any]]
) -> None:
    assert figures[task]["finite"]
    assert figures[task]["warnings"] == 0
    assert figures[task]["object_speed"] < 5.0
    assert figures[task]["finger_depth"] < 0.025
