"""How far Gymnasium-Robotics strays from itself when the block starts a little elsewhere.

`.venv-transfer/bin/python -m experiments.physics.gymnasium_sensitivity RECORDING.npz OUT`, in the
environment that `make transfer` builds, replays the recorded pushes (see `fidelity.py`) with the
block shifted along x. Writes OUT/sensitivity.csv: error of the block's yaw and the largest error of
the other observation entries, as shares of their spread in the recording, and the episode that
contributes most to the former.
"""

# gymnasium-robotics is not installed where the type checker runs.
# pyright: reportMissingImports=false

import sys
from pathlib import Path
from typing import Any

import gymnasium
import gymnasium_robotics
import numpy as np

from experiments.table import write_table

SHIFTS = (0.0, 1e-6, 1e-4, -1e-4, 1e-3, -1e-3, 3e-3, -3e-3)  # metres
YAW = 13
MOVING = [i for i in range(25) if i not in (9, 10)]  # the fingers of push stay shut


def replay(recording: Any, shift: float) -> np.ndarray:
    """Observations [episodes, 51, 25] of the recorded pushes with the block shifted by `shift`."""
    gymnasium.register_envs(gymnasium_robotics)
    env = gymnasium.make("FetchPush-v4")
    robot: Any = env.unwrapped
    starts, episodes = recording["push/observation"][:, 0], []
    for start, actions in zip(starts, recording["push/action"], strict=True):
        env.reset(seed=0)
        block = robot._utils.get_joint_qpos(robot.model, robot.data, "object0:joint")
        block[:2] = start[3] + shift, start[4]
        robot._utils.set_joint_qpos(robot.model, robot.data, "object0:joint", block)
        robot._mujoco.mj_forward(robot.model, robot.data)
        path = [robot._get_obs()["observation"]]
        path += [env.step(action)[0]["observation"] for action in actions]
        episodes.append(path)
    return np.array(episodes)


def compare(recording: Any) -> list[dict[str, Any]]:
    """One row per shift."""
    recorded, rows = recording["push/observation"], []
    spread = recorded.std(axis=(0, 1))[MOVING]
    for shift in SHIFTS:
        error = replay(recording, shift) - recorded
        error[..., 11:14] = (error[..., 11:14] + np.pi) % (2 * np.pi) - np.pi
        shares = dict(zip(MOVING, np.abs(error).mean(axis=(0, 1))[MOVING] / spread, strict=True))
        worst = int(np.abs(error[..., YAW]).mean(axis=1).argmax())
        yaw = shares.pop(YAW)
        rows.append(
            {
                "shift_mm": 1000 * shift,
                "yaw": f"{yaw:.4f}",
                "worst_other_entry": f"{max(shares.values()):.4f}",
                "episode": worst,
            }
        )
    return rows


if __name__ == "__main__":
    if len(sys.argv) != 3:
        sys.exit(__doc__)
    with np.load(sys.argv[1]) as file:
        table = compare(dict(file))
    out = Path(sys.argv[2])
    out.mkdir(parents=True, exist_ok=True)
    write_table(out / "sensitivity.csv", table)
    for row in table:
        print(*row.values(), sep="\t")
