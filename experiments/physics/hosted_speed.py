"""How fast Gymnasium tasks are: `python -m experiments.physics.hosted_speed gymnasium:ID ...`.

Times whole rollouts of ROWS episodes with random actions through the loop, where the environment
lives in a process of its own, and of Gymnasium's vector environment by itself, in turns; and the
task `reach` of this package on the same machine. All figures are ratios of steps per second within
a round: the median, least and greatest over rounds. Writes OUT/hosted_speed.csv, in which tasks
that are not measured now keep their rows: those of one interpreter (CGM_JAX_GYMNASIUM_PYTHON) are
measured together.
"""

import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import tyro

from cgm_jax.config.fields import SettingError
from cgm_jax.config.named import gymnasium_name, is_gymnasium, name_now
from cgm_jax.config.settings import Settings
from cgm_jax.envs.hosted.process import other_interpreter
from cgm_jax.host.command_line import parse, run_program
from experiments.table import read_table, write_table

OUT = Path(__file__).resolve().parents[1] / "results" / "hosted_speed"
ALONE = Path(__file__).with_name("hosted_alone.py")


@dataclass(kw_only=True)
class HostedSpeedOptions:
    """Compare Gymnasium tasks with their vector environments and with ours."""

    tasks: Annotated[tuple[str, ...], tyro.conf.Positional]
    """Such as gymnasium:cgm_jax:cgm_jax/FetchReach-v0."""

    rows: int = 16
    """Episodes side by side."""

    rounds: int = 5
    """Rollouts of each kind."""

    out: Path = OUT
    """Directory for the table."""

    def check(self) -> None:
        """Check names and numbers.

        Raises:
            SettingError: a task that is none of Gymnasium's, or a number below 1.
        """
        if not self.tasks or not all(is_gymnasium(task) for task in self.tasks):
            raise SettingError("tasks: name environments as gymnasium:ID or gymnasium:MODULE:ID")
        for name in ("rows", "rounds"):
            if getattr(self, name) < 1:
                raise SettingError(f"{name}: {getattr(self, name)} is below 1")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the program on command-line arguments; return its exit code."""
    options = parse(HostedSpeedOptions, arguments, "python -m experiments.physics.hosted_speed")
    options.check()
    ours = through_the_loop("reach", options.rows)
    options.out.mkdir(parents=True, exist_ok=True)
    path = options.out / "hosted_speed.csv"
    table: list[Any] = list(read_table(path)) if path.exists() else []
    for task in options.tasks:
        name_now(task)
        hosted = through_the_loop(task, options.rows)
        alone = by_itself(task, options.rows)
        rates = [
            tuple(steps_per_second(one) for one in (hosted, alone, ours))
            for _ in range(options.rounds)
        ]
        row = {
            "task": task.rpartition(":")[2],
            "rows": options.rows,
            "rounds": options.rounds,
            "of_its_vector_environment": _ratio(rates, 1),
            "of_reach_here": _ratio(rates, 2),
        }
        print(row, flush=True)
        table = [*(kept for kept in table if kept["task"] != row["task"]), row]
        write_table(path, table)  # now, lest it be lost if the next one fails
    return 0


def _ratio(rates: Sequence[tuple[float, ...]], other: int) -> str:
    ratios = [each[0] / each[other] for each in rates]
    return f"{statistics.median(ratios):.2f} ({min(ratios):.2f} to {max(ratios):.2f})"


def steps_per_second(rollout: Callable[[], int]) -> float:
    """The rate of one rollout, which says how many steps it took."""
    begun = time.perf_counter()
    return rollout() / (time.perf_counter() - begun)


def through_the_loop(env_name: str, rows: int) -> Callable[[], int]:
    """Rollouts as in training, compiled."""
    import jax

    from cgm_jax.loop.environment import make_environment
    from cgm_jax.loop.rollout import drawn_goals, reset, roll_out

    env = make_environment(Settings(env=env_name))

    def policy(observation: jax.Array, goal: jax.Array, noise: Any) -> jax.Array:
        del goal
        return noise

    @jax.jit
    def run(key: jax.Array) -> jax.Array:
        first_key, noise_key = jax.random.split(key)
        first = reset(env, first_key, rows)
        shape = (env.episode_length, rows, env.action_size)
        noise: Any = jax.random.uniform(noise_key, shape, minval=-1.0, maxval=1.0)
        return roll_out(env, policy, first, drawn_goals(env, first), noise).episodes.observation

    def rollout() -> int:
        jax.block_until_ready(run(jax.random.key(0)))
        return rows * env.episode_length

    rollout()  # compiles
    return rollout


def by_itself(name: str, rows: int) -> Callable[[], int]:
    """Rollouts of Gymnasium's vector environment, in the interpreter that has the task."""
    module, env_id = gymnasium_name(name)
    process = subprocess.Popen(
        [other_interpreter() or sys.executable, str(ALONE), module or "", env_id, str(rows)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    assert process.stdin is not None
    assert process.stdout is not None
    asked, answers = process.stdin, process.stdout

    def rollout() -> int:
        print(file=asked, flush=True)
        return int(answers.readline())

    rollout()
    return rollout


if __name__ == "__main__":
    run_program(main)
