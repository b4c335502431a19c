"""`python -m experiments.gpu.parity ENGINE TASK EPISODES FILE`: scripted episodes on one engine.

A process of its own, since C MuJoCo needs JAX on a CPU and the others are to run on the GPU.
"""

# Brax types the parts of its State as unknown.
# pyright: reportOptionalSubscript=false

import sys
from pathlib import Path

import numpy as np

from cgm_jax import envs
from experiments.physics.scripted import CONTROLLERS, Player, free_motion, success


def play(engine: str, task: str, episodes: int, path: Path) -> None:
    """Write grips [T + 1, E, 3] of a free motion, and success [E] of a controller."""
    player = Player(envs.make(task, engine=engine))
    states = player.play(free_motion, episodes)
    grips = np.array([state.obs["observation"][:, :3] for state in states])
    played = player.play(CONTROLLERS[task], episodes)
    np.savez(path, grips=grips, success=success(played))


if __name__ == "__main__":
    play(sys.argv[1], sys.argv[2], int(sys.argv[3]), Path(sys.argv[4]))
