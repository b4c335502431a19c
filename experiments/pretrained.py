"""The policies that come with the package: `make pretrained` trains, chooses and measures them.

For each task a run is trained. Of its last policy and the last three that improved on all before,
the best over 500 episodes is taken, and then measured over 1,000 others. Writes
cgm_jax/pretrained/<task>.npz and pretrained.json, which says how.
"""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import tyro

from cgm_jax import train
from cgm_jax.config.fields import SettingError
from cgm_jax.config.settings import Settings
from cgm_jax.host.command_line import parse, run_program
from cgm_jax.pretrained import FOLDER, NAMES, RECORD
from cgm_jax.results.chosen import Policies
from cgm_jax.results.plan import Plan
from cgm_jax.storage.files import replacing
from cgm_jax.storage.layout import CONFIG
from cgm_jax.storage.policies import load_policy
from cgm_jax.storage.run_directory import RunDirectory

OPTIONS = {
    "reach": ["--epochs", "8"],
    "push": ["--curriculum", "full", "--epochs", "40"],
    "pick_and_place": ["--epochs", "41"],
}
"""How each is trained; `--preset cpu --env TASK` comes first."""

CHOOSING = Plan(episodes=500, seed=2000)
MEASURING = Plan(episodes=1000, seed=1000)
"""As `python -m cgm_jax.evaluate --episodes 1000` does."""


@dataclass(kw_only=True)
class PretrainedOptions:
    """Train, choose and measure the policies that come with the package."""

    tasks: Annotated[tuple[str, ...], tyro.conf.Positional] = NAMES
    """Of which tasks."""

    out: Path = Path("runs/pretrained")
    """Directory of the runs, one a task; what was stopped resumes."""

    trained: bool = False
    """Take the runs as they are, whatever they were trained with, and train nothing."""

    into: Path = FOLDER
    """Directory for the policies and pretrained.json."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the program on command-line arguments; return its exit code."""
    options = parse(PretrainedOptions, arguments, "python -m experiments.pretrained")
    for task in options.tasks:
        if task not in OPTIONS:
            raise SettingError(f"tasks: {task!r} is none of {', '.join(OPTIONS)}")
    options.into.mkdir(parents=True, exist_ok=True)
    path = options.into / RECORD.name
    record = json.loads(path.read_text()) if path.exists() else {}
    for task in options.tasks:
        directory = RunDirectory(options.out / task)
        words = ["--preset", "cpu", "--env", task, *OPTIONS[task], "--out", str(directory.path)]
        if not options.trained and (code := train.main(words)):
            return code
        record[task], arrays = chosen(task, directory)
        with replacing(options.into / f"{task}.npz") as file:
            np.savez_compressed(file, **arrays)  # pyright: ignore[reportArgumentType]
        path.write_text(json.dumps(record, indent=2) + "\n")
        print(task, record[task])
    return 0


def chosen(task: str, directory: RunDirectory) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """What is to be known of the best policy of a run, and its arrays."""
    candidates: dict[str, Path] = {}
    for run in (run for group in directory.config.groups() for run in group.runs):
        last = directory.policy_path(run)
        improved = last.parent.glob(f"improvements/{run.name}_epoch*.npz")
        latest = sorted(improved, key=lambda path: int(path.stem.rpartition("_epoch")[2]))[-3:]
        candidates |= {path.stem: path for path in (*latest, last)}
    rates = success(task, candidates, CHOOSING)
    best = max(reversed(rates), key=rates.__getitem__)  # of equals the last
    measured = success(task, {best: candidates[best]}, MEASURING)[best]
    config = json.loads((directory.path / CONFIG).read_bytes())
    facts = {
        "command": " ".join(config["command"]),
        "commit": config["commit"],
        "epochs": directory.metrics()[-1]["epoch"],
        "policy": best,
        "chosen_among": len(candidates),
        "success_rate": measured,
        "episodes": MEASURING.episodes,
    }
    return facts, load_policy(candidates[best])


def success(task: str, files: dict[str, Path], plan: Plan) -> dict[str, float]:
    """Success rates of policy files of one task."""
    from cgm_jax.results.policies import evaluate_policies

    outcomes = evaluate_policies([Policies(Settings(env=task), files)], plan)
    return {name: outcome.success_rate for name, outcome in outcomes.items()}


if __name__ == "__main__":
    run_program(main)
