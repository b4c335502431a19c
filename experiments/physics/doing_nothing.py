"""How often a goal is achieved by doing nothing: `python -m experiments.physics.doing_nothing OUT`.

Writes OUT/doing_nothing.csv: the success of zero actions, per task. A policy that has learned
nothing is as good, since some goals lie where the block (or the gripper) is anyway.
"""

from pathlib import Path
from typing import Any

import numpy as np

from cgm_jax import envs
from experiments.command_line import paths
from experiments.physics.scripted import Player, success
from experiments.table import write_table

EPISODES = 2000
TASKS = ("reach", "push", "pick_and_place")


def nothing(observation: np.ndarray, goal: np.ndarray, step: int) -> np.ndarray:
    """The controller that does not move."""
    return np.zeros((len(goal), 4))


def measure(task: str) -> dict[str, Any]:
    """One row of the table."""
    solved = success(Player(envs.make(task, engine="native")).play(nothing, EPISODES))
    return {"task": task, "episodes": EPISODES, "success": round(float(solved.mean()), 4)}


def main(out: Path) -> None:
    """Write the table and print it."""
    out.mkdir(parents=True, exist_ok=True)
    rows = [measure(task) for task in TASKS]
    write_table(out / "doing_nothing.csv", rows)
    for row in rows:
        print(*row.values(), sep="\t")


if __name__ == "__main__":
    main(*paths("experiments.physics.doing_nothing", __doc__, "out"))
