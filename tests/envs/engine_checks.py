"""`python -m tests.envs.engine_checks TASK ENGINE`: an engine beside C MuJoCo, figures as JSON.

A program of its own because MJX on a CPU needs a compiler flag before JAX starts, and one program
for all checks of a task because most of its time is compilation.
"""

import json
import sys

import numpy as np

from cgm_jax import envs
from experiments.physics.scripted import CONTROLLERS, Player, free_motion, success
from tests.envs.adversary import attack
from tests.envs.measures import finger_depth, object_speed, observations, warnings

EPISODES = 100


def check(task: str, engine: str) -> dict[str, float]:
    """All figures of a task; lengths in metres."""
    native, other = (Player(envs.make(task, engine=name)) for name in ("native", engine))
    flights = [observations(player.play(free_motion, EPISODES)) for player in (native, other)]
    strayed = np.linalg.norm((flights[1] - flights[0])[..., :3], axis=-1)
    played = [player.play(CONTROLLERS[task], EPISODES) for player in (native, other)]
    attacked = other.play(attack, EPISODES)
    return {
        "strayed": float(strayed.max()),
        "moved": float(np.ptp(flights[0][..., :3], axis=0).min()),
        "lowest": float(flights[0][6:, :, 2].min()),
        "success": float(success(played[1]).mean()),
        "same_outcome": float(np.mean(success(played[0]) == success(played[1]))),
        "lifted": float(np.mean(observations(played[0])[-1, :, 5] > 0.45)),
        "warnings": warnings(played[1]) + warnings(attacked),
        "finite": bool(np.isfinite(observations(attacked)).all()),
        "object_speed": float(object_speed(attacked).max()),
        "finger_depth": float(finger_depth(other.env, attacked).max()),
    }


if __name__ == "__main__":
    print(json.dumps(check(*sys.argv[1:])))
