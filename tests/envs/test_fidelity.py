"""The Fetch tasks against episodes recorded from Gymnasium-Robotics."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cgm_jax import envs
from experiments.physics.fidelity import compare, difference, replay_task, replayer

RECORDING = Path(__file__).parents[1] / "data" / "gymnasium_fetch.npz"


@pytest.fixture(scope="module")
def recording() -> dict[str, Any]:
    with np.load(RECORDING) as file:
        return dict(file)


def test_open_loop_replay_stays_within_a_centimetre_of_the_recording(
    recording: dict[str, Any],
) -> None:
    replays, entries = compare(recording)
    assert len(replays) == 6
    assert len(entries) == 2 * 25
    moving = [row for row in entries if float(row["recorded_std"]) > at_rest(row["entry"])]
    assert len(moving) == 42
    for row in moving:  # off by a small part of its spread
        assert float(row["ratio"]) < 0.2, row
    for row in replays:
        assert row["episodes"] == 4
        assert row["median_largest_grip_error_cm"] < 1.0, row
        if row["kind"] == "scripted":
            assert row["median_final_object_error_cm"] < 0.5, row


def at_rest(entry: str) -> float:
    """The spread of what hardly moves: fingers that are blocked, a block that is not turned."""
    return 0.01 if "euler" in entry else 0.003 if "angular" in entry else 2e-4


@pytest.mark.parametrize("task", ["push", "pick_and_place"])
def test_the_first_observation_and_the_first_steps_are_the_recorded_ones(
    task: str, recording: dict[str, Any]
) -> None:
    recorded = recording[f"{task}/observation"]
    simulated = replay_task(task, recording, replayer(envs.make(task, engine="native")))
    error = np.abs(difference(simulated, recorded))
    assert error[:, 0, :9].max() < 5e-4  # positions, metres
    assert error[:, :4, :9].max() < 5e-3
    moved = np.linalg.norm(recorded[:, 3, :3] - recorded[:, 0, :3], axis=-1)
    assert moved.max() > 0.03  # there was something to follow
