"""`python -m experiments.gpu.cases PART CASE OUT [--rehearse]`: one case; its figures as JSON."""

import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import numpy as np

from cgm_jax.config.grid import Group, build_groups
from cgm_jax.host.command_line import refuse
from cgm_jax.host.exit_codes import FINISHED, ExitCode
from cgm_jax.host.memory import estimate_memory
from cgm_jax.host.startup import prepare_jax
from cgm_jax.loop.environment import make_environment
from cgm_jax.loop.training import make_programs, make_trainer
from cgm_jax.measuring.child import MeasurementError, output_of
from cgm_jax.measuring.engines import engine_rate
from cgm_jax.measuring.figures import seconds
from cgm_jax.measuring.start import measure_starts
from cgm_jax.measuring.updates import measure_updates
from cgm_jax.results.statistics import first_to_hold

Figures = list[dict[str, Any]]

SMALL: dict[str, list[Any]] = {
    "environments": [4],
    "updates_per_cycle": [4],
    "batch_size": [32],
    "evaluation_episodes": [10],
    "replay_transitions": [10_000],
}
"""What makes a preset a rehearsal."""


def figure(name: str, value: float, unit: str = "") -> dict[str, Any]:
    """A row of gpu.csv, but for what it is about."""
    return {"figure": name, "value": float(f"{value:.4g}"), "unit": unit}


def plain(value: float | None) -> float:
    """A metric that may be missing, as null, as of a run that diverged."""
    return np.nan if value is None else value


def rate(engine: str, case: str, rehearse: bool) -> Figures:
    """How fast an engine simulates so many environments."""
    found = engine_rate(engine, "push", int(case), repeats=3, steps=5 if rehearse else 50)
    return [
        figure("first rollout after", found.compiling, "s"),
        figure("rate", found.rate, "environment steps/s"),
        figure("physics warnings", found.warnings),
    ]


def updates(case: str, rehearse: bool) -> Figures:
    """Updates against the matrix-product rate."""
    rows, above = [], ""
    for one in measure_updates(1 if rehearse else 5):
        if one.name.startswith(" "):  # it belongs to the one above
            rows.append(figure(f"{above}: {one.name.strip()}", one.value, one.unit))
        else:
            above = one.name.partition(" / ")[0]
            rows.append(figure(one.name, one.value, one.unit))
    return rows


def start(case: str, rehearse: bool) -> Figures:
    """From the command to the end of the first training cycle."""
    return [figure(one.name, one.value, one.unit) for one in measure_starts(1, uncounted=0)]


def runs(case: str, rehearse: bool) -> Figures:
    """So many runs side by side: time per run and cycle."""
    group = _group("cpu", "push", rehearse, seed=list(range(int(case))))
    programs = make_programs(make_trainer(make_environment(group.settings), group.settings))
    hyper, cycles = group.hyper(), 2 if rehearse else 10
    states = [programs.start(hyper)]

    def train() -> None:
        states.append(jax.block_until_ready(programs.train(states.pop(), hyper, cycles)))

    compiling = seconds(train)
    taken = float(np.median([seconds(train) for _ in range(3)]))
    return [
        figure("first cycles after", compiling, "s"),
        figure("per run and cycle", 1e3 * taken / cycles / int(case), "ms"),
    ]


def memory(case: str, rehearse: bool) -> Figures:
    """The estimate for preset gpu against what a cycle and an evaluation took."""
    group = _group("gpu", case, rehearse)
    trainer = make_trainer(make_environment(group.settings), group.settings)
    programs, hyper = make_programs(trainer), group.hyper()
    estimate = estimate_memory(trainer, group.runs[0].hyper).total(1)
    whole_cycle = trainer.parts(group.runs[0].hyper).total
    state = programs.train(programs.start(hyper), hyper, whole_cycle)
    jax.block_until_ready(programs.evaluate(state, hyper))
    taken = _peak_bytes()
    return [
        figure("estimate", estimate / 2**20, "MiB"),
        figure("taken at most", taken / 2**20, "MiB"),
        figure("estimate / taken", estimate / taken),
    ]


def parity(engine: str, case: str, rehearse: bool, out: Path) -> Figures:
    """An engine here against C MuJoCo in a process on the CPU."""
    episodes = 4 if rehearse else 100
    files = {name: out / f"parity-{case}-{name}.npz" for name in (engine, "native")}
    for name, path in files.items():
        on_cpu = {"JAX_PLATFORMS": "cpu", "CUDA_VISIBLE_DEVICES": ""} if name == "native" else {}
        words = [name, case, str(episodes), str(path)]
        output_of([sys.executable, "-m", "experiments.gpu.parity", *words], on_cpu)
    here, there = (dict(np.load(path)) for path in files.values())
    strayed = np.linalg.norm(here["grips"] - there["grips"], axis=-1)
    return [
        figure("grip strays in free motion at most", 1e3 * strayed.max(), "mm"),
        figure("success of a controller", here["success"].mean()),
        figure("success of it on native", there["success"].mean()),
        figure("same outcome", np.mean(here["success"] == there["success"])),
    ]


def learning(case: str, rehearse: bool, out: Path) -> Figures:
    """Preset gpu to 90 %, which the same command resumes."""
    directory = out / "learning" / case
    words = ["--preset", "gpu", "--env", case, "--leave-at", "0.9", "--out", str(directory)]
    if rehearse:
        words += ["--epochs", "2"]
        for name, (value,) in SMALL.items():
            words += [f"--{name.replace('_', '-')}", str(value)]
    command = [sys.executable, "-m", "cgm_jax.train", *words]
    output_of(command, accepted=FINISHED)
    lines = (directory / "metrics.jsonl").read_text().splitlines()
    rows = [json.loads(line) for line in lines]
    held = first_to_hold(rows, 0.9) or {"env_steps": np.nan, "wall_s": np.nan}
    return [
        figure("environment steps to 90 % held", held["env_steps"]),
        figure("seconds of training to 90 % held", held["wall_s"], "s"),
        figure("environment steps trained", rows[-1]["env_steps"]),
        figure("success in the end", plain(rows[-1]["success_rate"])),
    ]


def _group(preset: str, env: str, rehearse: bool, **grid: list[Any]) -> Group:
    small = SMALL if rehearse else {}
    return build_groups(preset, {"env": [env], "curriculum": ["full"], **small, **grid})[0]


def _peak_bytes() -> int:
    """The most that the device has held; on a CPU, that the process has."""
    statistics = jax.devices()[0].memory_stats()
    if statistics and "peak_bytes_in_use" in statistics:
        return statistics["peak_bytes_in_use"]
    import resource

    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 2**10


PARTS: dict[str, Callable[[str, bool, Path], Figures]] = {
    "rate_mjx": lambda case, rehearse, out: rate("mjx", case, rehearse),
    "rate_warp": lambda case, rehearse, out: rate("warp", case, rehearse),
    "updates": lambda case, rehearse, out: updates(case, rehearse),
    "start": lambda case, rehearse, out: start(case, rehearse),
    "runs": lambda case, rehearse, out: runs(case, rehearse),
    "memory": lambda case, rehearse, out: memory(case, rehearse),
    "parity_mjx": lambda case, rehearse, out: parity("mjx", case, rehearse, out),
    "parity_warp": lambda case, rehearse, out: parity("warp", case, rehearse, out),
    "learning": learning,
}


if __name__ == "__main__":
    part, case, out = sys.argv[1:4]
    prepare_jax()
    try:
        print(json.dumps(PARTS[part](case, "--rehearse" in sys.argv, Path(out))))
    except MeasurementError as error:
        refuse(str(error), ExitCode.FAILED)
