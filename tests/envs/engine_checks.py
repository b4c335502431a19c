"""`python -m tests.envs.mjx_checks TASK`: MJX beside C MuJoCo, figures printed as JSON.

A program of its own because MJX on a CPU needs a compiler flag before JAX starts, and one program
for all checks of a task because most of its time is compilation.
"""

import json
import sys

import numpy as np

from cgm_jax import envs
from experiments.physics.scripted import CONTROLLERS, Player, success
from tests.envs.adversary import attack
from tests.envs.measures import finger_depth, object_speed, observations, warnings

EPISODES = 100


def free_motion(observation: np.ndarray, goal: np.ndarray, step: int) -> np.ndarray:
    """Up first, so that nothing is touched, and then about at random."""
    action = np.random.default_rng(step).uniform(-1.0, 1.0, (len(goal), 4))
    action[:, 2] = 1.0 if step < 6 else action[:, 2] / 2
    return action


def check(task: str) -> dict[str, float]:
    """All figures of a task; lengths in metres."""
    native, mjx = (Player(envs.make(task, engine=engine)) for engine in ("native", "mjx"))
    flights = [observations(player.play(free_motion, EPISODES)) for player in (native, mjx)]
    strayed = np.linalg.norm((flights[1] - flights[0])[..., :3], axis=-1)
    played = [player.play(CONTROLLERS[task], EPISODES) for player in (native, mjx)]
    attacked = mjx.play(attack, EPISODES)
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
        "finger_depth": float(finger_depth(mjx.env, attacked).max()),
    }


if __name__ == "__main__":
    print(json.dumps(check(sys.argv[1])))
