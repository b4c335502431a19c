"""Which timestep? `python -m experiments.physics.timestep RECORDING.npz OUT`.

Writes OUT/timestep.csv. Per timestep (with as many substeps as fill a control step of 0.04 s) and
time constant of the gripper's weld: errors against the recording that `fidelity.py` describes,
success of the hand-written controllers, and speed relative to the model as it is. The speed is that
of replaying the recording, all variants in turn, five times over; the median of the ratios within
each round.
"""

import dataclasses
import time
from pathlib import Path
from typing import Any

import numpy as np

from cgm_jax import envs
from cgm_jax.envs.fetch import FetchEnvironment
from cgm_jax.envs.physics.native import NativePhysics
from cgm_jax.envs.scene import load_scene
from experiments.command_line import paths
from experiments.physics.fidelity import Replay, difference, errors, replay_task, replayer
from experiments.physics.scripted import CONTROLLERS, Player, success
from experiments.table import write_table

TIMESTEPS = (0.002, 0.004, 0.005, 0.008, 0.01)
WELD_TIMES = (0.02, 0.0205)  # Gymnasium-Robotics', and that of assets/fetch/arm.xml
TASKS = ("push", "pick_and_place")
ROUNDS = 5
EPISODES = 500

Variant = tuple[str, float, float]
"""Task, timestep and time constant of the weld, both in seconds."""


def make_variant(variant: Variant) -> FetchEnvironment:
    """The task's environment on C MuJoCo with another timestep and weld."""
    task, timestep, weld_time = variant
    scene = load_scene(envs.TASKS[task])
    scene.model.opt.timestep = timestep
    scene.model.eq_solref[0, 0] = weld_time
    env = envs.make(task, engine="native")
    return dataclasses.replace(env, scene=scene, physics=NativePhysics(scene))


def relative_speeds(replays: dict[Variant, Replay], recording: Any) -> dict[Variant, float]:
    """Speed of each variant relative to its task's model as it is."""
    seconds = {variant: [] for variant in replays}
    for _ in range(ROUNDS):
        for variant, replay in replays.items():
            began = time.perf_counter()
            replay_task(variant[0], recording, replay)
            seconds[variant].append(time.perf_counter() - began)
    return {
        variant: float(np.median(np.divide(seconds[as_it_is(variant[0])], times)))
        for variant, times in seconds.items()
    }


def as_it_is(task: str) -> Variant:
    """The variant that assets/fetch/ describes."""
    model = load_scene(envs.TASKS[task]).model
    return task, float(model.opt.timestep), float(model.eq_solref[0, 0])


def compare(recording: Any) -> list[dict[str, Any]]:
    """One row per variant."""
    environments = {
        variant: make_variant(variant)
        for variant in ((task, *pair) for task in TASKS for pair in _pairs())
    }
    replays = {variant: replayer(env) for variant, env in environments.items()}
    rows = []
    for variant, env in environments.items():
        task, timestep, weld_time = variant
        simulated = replay_task(task, recording, replays[variant])
        error = difference(simulated, recording[f"{task}/observation"])
        grip = errors(error)[0]
        block = errors(error[recording[f"{task}/kind"] == "scripted"])[1]
        solved = success(Player(env).play(CONTROLLERS[task], EPISODES))
        rows.append(
            {
                "task": task,
                "timestep": timestep,
                "substeps": env.scene.substeps,
                "weld_time": weld_time,
                "median_largest_grip_error_mm": round(1000 * float(np.median(grip)), 2),
                "median_final_object_error_mm": round(1000 * float(np.median(block)), 2),
                "scripted_success": round(float(solved.mean()), 3),
            }
        )
    speeds = relative_speeds(replays, recording)
    for row, variant in zip(rows, environments, strict=True):
        row["relative_speed"] = round(speeds[variant], 2)
    return rows


def _pairs() -> list[tuple[float, float]]:
    return [(timestep, weld_time) for timestep in TIMESTEPS for weld_time in WELD_TIMES]


def main(recording: Path, out: Path) -> None:
    """Write the table and print it."""
    with np.load(recording) as file:
        rows = compare(dict(file))
    out.mkdir(parents=True, exist_ok=True)
    write_table(out / "timestep.csv", rows)
    for row in rows:
        print(*row.values(), sep="\t")


if __name__ == "__main__":
    main(*paths("experiments.physics.timestep", __doc__, "recording", "out"))
