"""Goal environments that differ from the point mass in what a task is made of."""

import atexit
import os
import signal
import subprocess
import time
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, SyncVectorEnv

from tests.examples.numpy_point_mass import NumpyPointMass


class OneForSuccess(NumpyPointMass):
    """Rewards 1 and 0, for one goal at a time, and keeps its threshold to itself."""

    distance_threshold = property()  # pyright: ignore[reportAssignmentType]

    def compute_reward(self, achieved_goal: np.ndarray, desired_goal: np.ndarray, info: Any) -> Any:
        off = abs(float(achieved_goal[0]) - float(desired_goal[0]))
        return float(off < 0.3 and abs(float(achieved_goal[1]) - float(desired_goal[1])) < 0.2)


class Dense(NumpyPointMass):
    """Rewards that are distances; says of a goal that is not achieved that it is."""

    def compute_reward(self, achieved_goal: np.ndarray, desired_goal: np.ndarray, info: Any) -> Any:
        return -np.linalg.norm(achieved_goal - desired_goal, axis=-1)

    def step(self, action: np.ndarray) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        return (*super().step(action)[:4], {"is_success": True})


class Ending(NumpyPointMass):
    """Terminates after so many steps as its first position says; some are truncated."""

    def step(self, action: np.ndarray) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        if self._steps == 0:
            self._end = 3 + int(abs(self._position[0]) * 40)
        shown, reward, _, truncated, info = super().step(action)
        last = self._steps >= self._end
        cut = bool(self._goal[0] < 0.0)
        return shown, reward, last and not cut, truncated or (last and cut), info


class Crashing(NumpyPointMass):
    """Terminates on failure, in the third step."""

    def step(self, action: np.ndarray) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        shown, reward, _, truncated, info = super().step(action)
        return shown, reward, self._steps == 3, truncated, info


class Narrow(NumpyPointMass):
    """Bounds that a scaled action could pass by a rounding, and that `step` insists on."""

    def __init__(self) -> None:
        super().__init__()
        self.action_space = gymnasium.spaces.Box(-0.1, 0.7, (2,), np.float32)

    def step(self, action: np.ndarray) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        assert self.action_space.contains(action), action
        return super().step(action)


class NoRule(Dense):
    distance_threshold = None  # pyright: ignore[reportAssignmentType]


class TrueThreshold(Dense):
    distance_threshold = True


class Still(Dense):
    """Rewards that are distances, and a point that no action moves."""

    def step(self, action: np.ndarray) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        shown, reward, terminated, truncated, _ = NumpyPointMass.step(self, 0.0 * action)
        return shown, reward, terminated, truncated, {}


class OneStep(Dense):
    """Rewards that are distances, and one step to each episode."""

    def step(self, action: np.ndarray) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        shown, reward, *_ = NumpyPointMass.step(self, action)
        return shown, reward, True, False, {}


class Constant(NumpyPointMass):
    """Rewards that say nothing."""

    def compute_reward(self, achieved_goal: np.ndarray, desired_goal: np.ndarray, info: Any) -> Any:
        return np.full(achieved_goal.shape[:-1], -1.0)


class Walled(OneForSuccess):
    """Knows no goals that are far away."""

    def compute_reward(self, achieved_goal: np.ndarray, desired_goal: np.ndarray, info: Any) -> Any:
        if np.abs(achieved_goal).max() > 50.0:
            raise IndexError("there is no such place")
        return super().compute_reward(achieved_goal, desired_goal, info)


class Unwritten(NumpyPointMass):
    """Has a threshold, and of `compute_reward` only the name."""

    def step(self, action: np.ndarray) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        self._position = self._position + 0.1 * action
        self._steps += 1
        return self._observation(), 0.0, False, self._steps >= self.episode_length, {}

    def compute_reward(self, achieved_goal: np.ndarray, desired_goal: np.ndarray, info: Any) -> Any:
        raise NotImplementedError


class ReadingInfo(Unwritten):
    """Has no threshold, and rewards what `step` has said."""

    distance_threshold = None  # pyright: ignore[reportAssignmentType]

    def compute_reward(self, achieved_goal: np.ndarray, desired_goal: np.ndarray, info: Any) -> Any:
        return float(info["is_success"])


class InPlace(NumpyPointMass):
    """Writes into what it is given; so its point is at what is left of the way to the goal."""

    def step(self, action: np.ndarray) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        action *= 0.5
        return super().step(action)

    def compute_reward(self, achieved_goal: np.ndarray, desired_goal: np.ndarray, info: Any) -> Any:
        achieved_goal -= desired_goal
        return super().compute_reward(achieved_goal, 0.0 * desired_goal, info)


class MovingGoal(NumpyPointMass):
    """Has another goal after each step."""

    def step(self, action: np.ndarray) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        self._goal = self._goal + 0.01
        return super().step(action)


class OtherGoals(NumpyPointMass):
    """Achieves goals of other numbers than it desires."""

    def __init__(self) -> None:
        super().__init__()
        sizes = {"observation": 4, "achieved_goal": 2, "desired_goal": 3}
        self.observation_space = spaces.Dict(
            {name: spaces.Box(-6.0, 6.0, (size,), np.float64) for name, size in sizes.items()}
        )


class OtherShape(NumpyPointMass):
    """Shows less than it says."""

    def _observation(self) -> Any:
        return super()._observation() | {"observation": self._position}


class WholeActions(NumpyPointMass):
    """Takes whole numbers for actions."""

    def __init__(self) -> None:
        super().__init__()
        self.action_space = spaces.Box(-1, 1, (2,), np.int64)


class FarAway(NumpyPointMass):
    """Has goals where float32 has no tenths."""

    def reset(self, **options: Any) -> tuple[Any, dict[str, Any]]:
        super().reset(**options)
        self._goal = self._goal + 1e8
        return self._observation(), {}


class CutShort(NumpyPointMass):
    """Takes fewer steps than it is registered with."""

    episode_length = 10


class Drawn(NumpyPointMass):
    """Begins where no seed decides."""

    def reset(self, **options: Any) -> tuple[Any, dict[str, Any]]:
        super().reset(**options)
        self._position = np.random.default_rng().uniform(-1.0, 1.0, 2)
        return self._observation(), {}


class DrawnLater(NumpyPointMass):
    """Steps to where no seed decides."""

    def step(self, action: np.ndarray) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        return super().step(action + np.random.default_rng().uniform(-0.1, 0.1, 2))


class NotFinite(NumpyPointMass):
    """Shows no numbers after a step."""

    def step(self, action: np.ndarray) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        shown, reward, terminated, truncated, info = super().step(action)
        return shown | {"observation": np.full(4, np.nan)}, reward, terminated, truncated, info


class Failing(NumpyPointMass):
    """Fails once its process has seen more steps than it is looked at for."""

    taken = 0

    def step(self, action: np.ndarray) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        Failing.taken += 1
        if Failing.taken > 30:
            raise RuntimeError("the motor broke")
        return super().step(action)


class Closing(NumpyPointMass):
    """Writes down that it is closed, and then fails; so it does when its process ends."""

    def __init__(self) -> None:
        super().__init__()
        atexit.register(self._write, "exit")

    def close(self) -> None:
        self._write("close")
        raise RuntimeError("closed")

    def _write(self, line: str) -> None:
        with Path(os.environ["CLOSING_FILE"]).open("a") as file:
            print(line, file=file)


class Hanging(NumpyPointMass):
    """Does not get closed."""

    def close(self) -> None:
        time.sleep(600.0)


class Stubborn(Hanging):
    """Does not obey a signal, either."""

    def close(self) -> None:
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
        super().close()


class Reading(NumpyPointMass):
    """Starts a program that reads standard input, as itself does, and writes on standard output."""

    def __init__(self) -> None:
        super().__init__()
        subprocess.run(["head", "-c", "1"], check=True, timeout=30)
        subprocess.run(["echo", "noise"], check=True, timeout=30)
        try:
            raise RuntimeError(f"standard input has {input()!r}")
        except EOFError:
            pass


class Counted(NumpyPointMass):
    """Counts how many of it there are."""

    made = closed = 0

    def __init__(self) -> None:
        super().__init__()
        Counted.made += 1

    def close(self) -> None:
        Counted.closed += 1


class BreakingReset(Counted):
    """Fails where the seed is 666."""

    def reset(self, *, seed: int | None = None, **options: Any) -> tuple[Any, dict[str, Any]]:
        if seed == 666:
            raise RuntimeError("the gripper is jammed")
        return super().reset(seed=seed, **options)


class Printing(NumpyPointMass):
    """Prints more than a pipe holds."""

    def step(self, action: np.ndarray) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        print("x" * 10_000, flush=True)
        return super().step(action)


def resetting_itself(num_envs: int, mode: AutoresetMode | None, **_: Any) -> SyncVectorEnv:
    """Vector environments of other ways to reset; without a mode as before there were several."""
    made = [lambda: EndingEarly(mode) for _ in range(num_envs)]
    env = SyncVectorEnv(made, autoreset_mode=mode or AutoresetMode.SAME_STEP)
    if mode is None:
        env.metadata = {"render_modes": []}
    return env


class EndingEarly(NumpyPointMass):
    """Terminates in its third step."""

    def __init__(self, mode: AutoresetMode | None) -> None:
        del mode
        super().__init__()

    def step(self, action: np.ndarray) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        shown, reward, _, truncated, info = super().step(action)
        return shown, reward, self._steps == 3, truncated, info


VARIANTS = [
    *(
        OneForSuccess,
        Dense,
        Ending,
        Crashing,
        Narrow,
        NoRule,
        Still,
        OneStep,
        Constant,
        Walled,
        Unwritten,
    ),
    *(ReadingInfo, TrueThreshold, InPlace, MovingGoal),
    *(OtherGoals, OtherShape, WholeActions, FarAway, CutShort, Drawn, DrawnLater, NotFinite),
    *(Failing, Closing, Hanging, Stubborn, Reading, Counted, BreakingReset, Printing),
]
for variant in VARIANTS:
    name = variant.__name__
    gymnasium.register(f"tests/{name}-v0", f"{__name__}:{name}", max_episode_steps=25)
gymnasium.register("tests/Endless-v0", f"{NumpyPointMass.__module__}:NumpyPointMass")


for mode in (AutoresetMode.DISABLED, AutoresetMode.SAME_STEP, None):
    gymnasium.register(
        f"tests/Resetting{mode.name.title() if mode else ''}-v0",
        f"{__name__}:EndingEarly",
        vector_entry_point=f"{__name__}:resetting_itself",
        max_episode_steps=25,
        kwargs={"mode": mode},
    )
