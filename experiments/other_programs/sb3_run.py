"""One run of Stable-Baselines3, where it is installed (`make compare-sb3` builds that).

    python -m experiments.other_programs.sb3_run ARM TASK SEED CPU_SECONDS OUT.csv

An evaluation every 20,000 environment steps, and one in the end: 50 episodes without noise, with
other goals each time.
"""

# Stable-Baselines3 and Gymnasium-Robotics are not installed where the type checker runs.
# pyright: reportMissingImports=false

import sys
from pathlib import Path
from typing import Any

import gymnasium
import gymnasium_robotics
import numpy as np
import stable_baselines3 as sb3
import torch
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.noise import NormalActionNoise
from stable_baselines3.common.vec_env import DummyVecEnv

from experiments.other_programs.arms import (
    ARMS,
    EVALUATION_EPISODES,
    STEPS_PER_EVALUATION,
    TASKS,
    Arm,
)
from experiments.other_programs.curve import add, begin, cpu_seconds, is_wanted


class Curve(BaseCallback):
    """Writes how often the full goal is achieved, and ends once the CPU seconds are used up."""

    def __init__(self, path: Path, task: str, seed: int, limit: float) -> None:
        """Evaluate into `path`, in environments with a seed of their own."""
        super().__init__()
        self._path, self._limit = path, limit
        self._env = environments(task, 1)
        self._env.seed(1_000_000 + seed)
        self._evaluated = 0

    def _on_step(self) -> bool:
        """After each step of all environments."""
        if not is_wanted():
            return False
        going_on = cpu_seconds() < self._limit
        if self.num_timesteps - self._evaluated >= STEPS_PER_EVALUATION or not going_on:
            self._evaluated = self.num_timesteps
            add(self._path, self.num_timesteps, self._success_rate())
        return going_on

    def _success_rate(self) -> float:
        successes: list[float] = []

        def collect(local: dict[str, Any], _: dict[str, Any]) -> None:
            if local["done"]:
                successes.append(local["info"]["is_success"])

        evaluate_policy(self.model, self._env, EVALUATION_EPISODES, callback=collect)
        return float(np.mean(successes))


def environments(task: str, count: int) -> DummyVecEnv:
    """So many of a task, in this process."""
    gymnasium.register_envs(gymnasium_robotics)
    return DummyVecEnv([lambda: Monitor(gymnasium.make(TASKS[task]))] * count)


def learner(arm: Arm, task: str, seed: int) -> Any:
    """The agent of an arm before any training."""
    envs, settings = environments(task, arm.environments), dict(arm.settings)
    if arm.noise is not None:
        size = envs.action_space.shape[0]
        settings["action_noise"] = NormalActionNoise(np.zeros(size), arm.noise * np.ones(size))
    return getattr(sb3, arm.algorithm)(
        "MultiInputPolicy",
        envs,
        replay_buffer_class=sb3.HerReplayBuffer,
        replay_buffer_kwargs={"n_sampled_goal": 4, "goal_selection_strategy": "future"},
        seed=seed,
        device="cpu",
        **settings,
    )


def main(arm: str, task: str, seed: int, limit: float, path: Path) -> None:
    """Train until the CPU seconds are used up."""
    torch.set_num_threads(1)
    begin(path)
    model = learner(ARMS[arm], task, seed)
    model.learn(10**9, Curve(path, task, seed, limit))


if __name__ == "__main__":
    if len(sys.argv) != 6:
        sys.exit(__doc__)
    main(sys.argv[1], sys.argv[2], int(sys.argv[3]), float(sys.argv[4]), Path(sys.argv[5]))
