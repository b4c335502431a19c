"""Do policies carry over? `make transfer ARGS="RUN_DIRECTORY ..."`.

Plays every policy of the given run directories in Gymnasium-Robotics' own FetchPush-v4 and
FetchPickAndPlace-v4, and again here from the same starts to the same goals. So the goals are those
of Gymnasium-Robotics: in pick-and-place, half of them on the table. Prints a table and writes it to
OUT/transfer.csv.
"""

import subprocess
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import tyro

from cgm_jax.config.fields import SettingError
from cgm_jax.host.command_line import parse, run_program
from experiments.table import write_table

ROOT = Path(__file__).resolve().parents[2]
ENV_IDS = {"push": "FetchPush-v4", "pick_and_place": "FetchPickAndPlace-v4"}
DEFAULTS = (Path("runs/push"), Path("runs/pick_and_place"))


@dataclass(kw_only=True)
class TransferOptions:
    """Compare trained policies in Gymnasium-Robotics with themselves here."""

    directories: Annotated[tuple[Path, ...], tyro.conf.Positional] = DEFAULTS
    """Run directories whose policies to play."""

    episodes: int = 200
    """Episodes per policy."""

    seed: int = 0
    """Seed of Gymnasium-Robotics' first episode; the others follow."""

    python: Path = ROOT / ".venv-transfer" / "bin" / "python"
    """The Python that has gymnasium-robotics."""

    out: Path = ROOT / "experiments" / "results" / "transfer"
    """Directory for the table."""


def play_there(policy: Path, env_id: str, options: TransferOptions) -> dict[str, np.ndarray]:
    """Starts, goals and success in Gymnasium-Robotics, by `gymnasium_policy.py`."""
    with tempfile.TemporaryDirectory() as directory:
        file = Path(directory) / "episodes.npz"
        program = [str(options.python), "-m", "experiments.physics.gymnasium_policy"]
        numbers = str(options.episodes), str(options.seed)
        command = [*program, str(policy.resolve()), env_id, *numbers, str(file)]
        result = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
        if result.returncode:
            raise RuntimeError(result.stderr)
        with np.load(file) as episodes:
            return dict(episodes)


def play_here(policy: Path, task: str, there: dict[str, np.ndarray]) -> np.ndarray:
    """Success [episodes] of the policy here, from the same starts to the same goals."""
    import jax
    import jax.numpy as jnp

    from cgm_jax import envs
    from cgm_jax.storage.policies import act, load_policy

    env, arrays = envs.make(task), load_policy(policy)

    def step(state: Any, _: None) -> tuple[Any, None]:
        action = act(arrays, state.obs["observation"], state.obs["desired_goal"])
        return jax.vmap(env.step)(state, action), None

    @jax.jit
    def run(object_xy: jax.Array, goal: jax.Array) -> jax.Array:
        state = jax.vmap(env.reset_to)(object_xy, goal)
        return jax.lax.scan(step, state, length=env.episode_length)[0].metrics["success"]

    starts = (there[name].astype(np.float32) for name in ("object_xy", "desired_goal"))
    return np.asarray(run(*map(jnp.asarray, starts))) > 0


def compare(options: TransferOptions) -> list[dict[str, Any]]:
    """One row per policy; success in per cent.

    Raises:
        SettingError: a directory holds no sweep, or no policy of push or pick_and_place.
    """
    from cgm_jax.storage.run_directory import RunDirectory

    rows = []
    for directory in [RunDirectory.open(path) for path in options.directories]:
        for group in directory.config.groups():
            task = group.settings.env
            policies = {run.name: directory.policy_path(run) for run in group.runs}
            for name, policy in policies.items():
                if task not in ENV_IDS or not policy.exists():
                    continue
                there = play_there(policy, ENV_IDS[task], options)
                here = play_here(policy, task, there)
                scores = 100 * there["success"].mean(), 100 * here.mean()
                rows.append(
                    {
                        "policy": name,
                        "environment": ENV_IDS[task],
                        "episodes": options.episodes,
                        "success_there": f"{scores[0]:.1f}",
                        "success_here": f"{scores[1]:.1f}",
                        "loss": f"{scores[1] - scores[0]:.1f}",
                        "same_outcome": f"{100 * np.mean(there['success'] == here):.1f}",
                    }
                )
    if not rows:
        raise SettingError(f"directories: no policy of {' or '.join(ENV_IDS)} in them")
    return rows


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the program on command-line arguments; return its exit code."""
    options = parse(TransferOptions, arguments, "python -m experiments.physics.transfer")
    if options.episodes < 1:
        raise SettingError(f"episodes: {options.episodes} is not at least 1")
    if not options.python.is_file():
        raise SettingError(f"python: no {options.python}; `make transfer` builds it")
    rows = compare(options)
    options.out.mkdir(parents=True, exist_ok=True)
    write_table(options.out / "transfer.csv", rows)
    for row in [dict(zip(rows[0], rows[0], strict=True)), *rows]:
        print(*row.values(), sep="\t")
    return 0


if __name__ == "__main__":
    run_program(main)
