"""Replay recorded Gymnasium-Robotics episodes open loop.

`python -m experiments.physics.fidelity RECORDING.npz OUT` writes OUT/replay.csv (largest grip error
and final object error per task and kind) and OUT/observations.csv (mean absolute error per
observation entry, relative to the entry's standard deviation in the recording).

The recording holds, per task, `observation` [episodes, 51, 25], `action` [episodes, 50, 4],
`desired_goal` [episodes, 3] and `kind` (random, smooth, scripted). Each episode starts here with
its recorded object position, and its actions are replayed open loop.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from cgm_jax import envs
from cgm_jax.envs.fetch import FetchEnvironment
from experiments.command_line import paths
from experiments.table import write_table

ENTRIES = [
    *(f"grip_{axis}" for axis in "xyz"),
    *(f"object_{axis}" for axis in "xyz"),
    *(f"object_minus_grip_{axis}" for axis in "xyz"),
    *("right_finger", "left_finger"),
    *(f"object_euler_{axis}" for axis in "xyz"),
    *(f"object_velocity_{axis}" for axis in "xyz"),
    *(f"object_angular_velocity_{axis}" for axis in "xyz"),
    *(f"grip_velocity_{axis}" for axis in "xyz"),
    *("right_finger_velocity", "left_finger_velocity"),
]
EULER = slice(11, 14)
KINDS = ("random", "smooth", "scripted")


Replay = Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]


def replayer(env: FetchEnvironment) -> Replay:
    """Build a program that replays recorded episodes in `env`.

    Returns:
        A function from the episodes' observations [E, 51, 25], actions [E, 50, 4] and goals
        [E, 3] to the observations [E, 51, 25] of the same actions here.
    """

    def step(state: Any, action: jax.Array) -> tuple[Any, jax.Array]:
        state = jax.vmap(env.step)(state, action)
        return state, state.obs["observation"]

    @jax.jit
    def run(object_xy: jax.Array, actions: jax.Array, goals: jax.Array) -> jax.Array:
        state = jax.vmap(env.reset_to)(object_xy, goals)
        rest = jax.lax.scan(step, state, actions)[1]
        return jnp.concatenate([state.obs["observation"][None], rest])

    def replay(recorded: np.ndarray, actions: np.ndarray, goals: np.ndarray) -> np.ndarray:
        arrays = (recorded[:, 0, 3:5], actions.swapaxes(0, 1), goals)
        return np.asarray(run(*(jnp.asarray(array, jnp.float32) for array in arrays))).swapaxes(
            0, 1
        )

    return replay


def replay_task(task: str, recording: Any, replay: Replay) -> np.ndarray:
    """Observations [episodes, 51, 25] of a task's recorded actions, simulated here."""
    return replay(
        *(recording[f"{task}/{name}"] for name in ("observation", "action", "desired_goal"))
    )


def difference(simulated: np.ndarray, recorded: np.ndarray) -> np.ndarray:
    """Simulated minus recorded, with angles compared on the circle."""
    result = simulated - recorded
    result[..., EULER] = (result[..., EULER] + np.pi) % (2 * np.pi) - np.pi
    return result


def errors(error: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Largest grip error and final object error [E] (metres) of differences [E, 51, 25]."""
    grip = np.linalg.norm(error[..., :3], axis=-1).max(axis=1)
    return grip, np.linalg.norm(error[:, -1, 3:6], axis=-1)


def compare(recording: Any) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """Rows of both tables."""
    replays, entries = [], []
    for task in ("push", "pick_and_place"):
        recorded = recording[f"{task}/observation"]
        simulated = replay_task(task, recording, replayer(envs.make(task, engine="native")))
        error = difference(simulated, recorded)
        for kind in KINDS:
            grip, block = errors(error[recording[f"{task}/kind"] == kind])
            replays.append(
                {
                    "task": task,
                    "kind": kind,
                    "episodes": len(grip),
                    "median_largest_grip_error_cm": round(100 * float(np.median(grip)), 3),
                    "median_final_object_error_cm": round(100 * float(np.median(block)), 3),
                }
            )
        spread = recorded.std(axis=(0, 1))
        for name, mean, deviation in zip(ENTRIES, abs(error).mean((0, 1)), spread, strict=True):
            share = mean / deviation if deviation > 0 else np.nan
            row = {"task": task, "entry": name, "mean_absolute_error": f"{mean:.6f}"}
            entries.append({**row, "recorded_std": f"{deviation:.6f}", "ratio": f"{share:.4f}"})
    return replays, entries


def main(recording: Path, out: Path) -> None:
    """Write both tables and print the first."""
    with np.load(recording) as file:
        tables = compare(dict(file))
    out.mkdir(parents=True, exist_ok=True)
    for name, rows in zip(("replay", "observations"), tables, strict=True):
        write_table(out / f"{name}.csv", rows)
    for row in tables[0]:
        print(*row.values(), sep="\t")


if __name__ == "__main__":
    main(*paths("experiments.physics.fidelity", __doc__, "recording", "out"))
