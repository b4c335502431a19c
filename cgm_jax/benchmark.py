"""`python -m cgm_jax.benchmark`: how far the trainer is from what the machine can do.

Every figure is a ratio of two measurements of one process, taken in turn, so that a slow or
busy machine changes both. Nothing else should run meanwhile.
"""

import dataclasses
import itertools
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from rich.console import Console
from rich.table import Table

from cgm_jax.config.grid import Group, Run, build_groups
from cgm_jax.config.settings import SettingError
from cgm_jax.host.allotment import available_cores
from cgm_jax.host.command_line import parse, run_program
from cgm_jax.host.startup import prepare_jax


@dataclass(kw_only=True)
class BenchmarkOptions:
    """Measure rollouts, updates, sweeps and the start, as ratios."""

    part: Literal["all", "first-step"] = "all"
    """first-step: only start, take one training step, and exit."""

    repeats: int = 5
    """Measurements per figure; the median counts."""


@dataclass(frozen=True)
class Figure:
    """One measured figure; `low` or `high` is the bound that it should keep."""

    name: str
    value: float
    unit: str
    low: float | None = None
    high: float | None = None

    def row(self) -> tuple[str, str, str]:
        """Name, value and bound as text."""
        bound = f"at least {self.low:g}" if self.low is not None else ""
        bound = f"at most {self.high:g}" if self.high is not None else bound
        return self.name, f"{self.value:.3g} {self.unit}".strip(), bound


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the program on command-line arguments; return its exit code."""
    options = parse(BenchmarkOptions, arguments, "python -m cgm_jax.benchmark")
    if not 1 <= options.repeats <= 1000:
        raise SettingError(f"repeats: {options.repeats} is not within [1, 1000]")
    if options.part == "first-step":
        prepare_jax()
        _first_step()
        return 0
    # Before anything else runs: a process of its own each.
    starts = _measure_starts()
    prepare_jax()
    figures = [
        *starts,
        *_measure_rollouts(options.repeats),
        *_measure_updates(options.repeats),
        *_measure_sweep(options.repeats),
    ]
    table = Table("measured", "value", "target", title=f"{os.cpu_count()} cores")
    for figure in figures:
        table.add_row(*figure.row())
    Console().print(table)
    return 0


def _cpu_group(env: str, runs: int = 1) -> Group:
    """Runs of the cpu preset, which differ in their seed."""
    grid = {"env": [env], "engine": ["native"], "seed": list(range(runs))}
    return build_groups("cpu", {**grid, "replay_transitions": [100_000]})[0]


def _seconds(function: Callable[[], Any]) -> float:
    began = time.perf_counter()
    function()
    return time.perf_counter() - began


def _medians(functions: Sequence[Callable[[], Any]], repeats: int) -> list[float]:
    """Median seconds of each function, measured in turn after one warm-up each."""
    for function in functions:
        function()
    rounds = [[_seconds(function) for function in functions] for _ in range(repeats)]
    return [float(median) for median in np.median(rounds, axis=0)]


def _first_step() -> None:
    import jax

    from cgm_jax.loop.environment import make_environment
    from cgm_jax.loop.programs import make_programs, stack_runs
    from cgm_jax.loop.training import Trainer

    group = _cpu_group("push")
    programs = make_programs(Trainer(make_environment(group.settings), group.settings))
    hyper = stack_runs(group.runs)
    jax.block_until_ready(programs.train(programs.start(hyper), hyper, 1))


def _measure_starts() -> list[Figure]:
    """From the command to the end of the first training cycle, without and with a cache."""
    with tempfile.TemporaryDirectory() as cache:
        environment = {**os.environ, "JAX_COMPILATION_CACHE_DIR": cache}
        command = [sys.executable, "-m", "cgm_jax.benchmark", "--part", "first-step"]

        def start() -> None:
            subprocess.run(command, env=environment, check=True, cwd=Path.cwd())

        cold, warm = _seconds(start), _seconds(start)
    return [
        Figure("start to first training cycle, push, empty cache", cold, "s", high=40),
        Figure("the same, second time", warm, "s", high=15),
    ]


def _measure_rollouts(repeats: int) -> list[Figure]:
    """Control steps through the scan against `Batch.step` of the very same motion."""
    figures = []
    for task in ("push", "pick_and_place"):
        for simulations in (16, 64, 512):
            scan, raw = _rollout_seconds(task, simulations, repeats)
            steps = 50 * simulations
            figures += [
                Figure(
                    f"rollout, {task}, {simulations} environments: scan / raw Batch.step",
                    raw / scan,
                    "",
                    low=0.85 if simulations == 64 else None,
                ),
                Figure("  through the scan", steps / scan, "env_steps/s"),
            ]
    return figures


def _rollout_seconds(task: str, simulations: int, repeats: int) -> tuple[float, float]:
    import jax
    import jax.numpy as jnp
    from mujoco.batch import Batch

    from cgm_jax import envs
    from cgm_jax.envs.physics.native import SENSOR_STAGE

    env = envs.make(task, engine="native")
    actions = jax.random.uniform(jax.random.key(0), (50, simulations, 4), minval=-1.0, maxval=1.0)
    keys = jax.random.split(jax.random.key(1), simulations)
    first = jax.jit(jax.vmap(env.reset))(keys)

    def step(state: Any, action: jax.Array) -> tuple[Any, jax.Array]:
        state = jax.vmap(env.step)(state, action)
        return state, state.pipeline_state.engine_state

    scan = jax.jit(lambda state: jax.lax.scan(step, state, actions)[1])
    rows = np.asarray(scan(first)).view(np.float64)

    # A state row holds the commands that led to it: replaying them is the same work.
    batch = Batch(env.scene.model, simulations, available_cores())
    batch.bind("sensordata")
    batch.state[:] = rows[0]
    offsets = [batch.bind(name) for name in ("mocap_pos", "mocap_quat", "ctrl")]
    commands = []
    for row in rows:
        batch.state[:] = row
        commands.append([field.copy() for field in offsets])
    start = np.asarray(first.pipeline_state.engine_state).view(np.float64)  # pyright: ignore
    blocked = list(env.scene.blocked_addresses)

    def raw() -> None:
        batch.state[:] = start
        for command in commands:
            batch.bind("qpos")[:, blocked] = 0.0
            for field, values in zip(offsets, command, strict=True):
                field[:] = values
            batch.step(nstep=env.scene.substeps, stage=SENSOR_STAGE)

    raw()
    if not np.array_equal(batch.state, rows[-1]):
        raise RuntimeError("the raw simulation did not repeat the scan's motion")
    through_scan, raw_seconds = _medians(
        [lambda: jnp.asarray(scan(first)).block_until_ready(), raw], repeats
    )
    return through_scan, raw_seconds


def _measure_updates(repeats: int) -> list[Figure]:
    """Floating-point rate of the network updates against that of a large matrix product.

    Of the paper's networks with several batches, and of the cpu preset.
    """
    import jax
    import jax.numpy as jnp

    from cgm_jax.agents.ddpg import DDPG, Minibatch
    from cgm_jax.config.settings import Hyperparameters

    count, size = 10, 2048
    matrix = jax.random.normal(jax.random.key(0), (size, size))
    product = jax.jit(lambda matrix: matrix @ matrix)
    paper = DDPG(input_size=28, action_size=4, hidden_layers=(256, 256, 256), target_update_every=1)
    preset = _cpu_group("push").settings
    narrow = dataclasses.replace(
        paper,
        hidden_layers=preset.hidden_layers,
        actor_update_every=preset.actor_update_every,
    )
    figures, peak = [], 0.0
    for ddpg, batch_size in (*((paper, size) for size in (256, 512, 1024)), (narrow, 512)):
        agent = ddpg.initial_agent(jax.random.key(1))
        inputs = jax.random.normal(jax.random.key(2), (count, batch_size, 28))
        batches = Minibatch(inputs, jnp.tanh(inputs[..., :4]), -jnp.ones(inputs.shape[:2]), inputs)

        updates = jax.jit(
            lambda agent, batches, ddpg=ddpg: ddpg.train(agent, batches, Hyperparameters())[0]
        )
        update_seconds, product_seconds = _medians(
            [
                lambda agent=agent, batches=batches, updates=updates: jax.block_until_ready(
                    updates(agent, batches)
                ),
                lambda: product(matrix).block_until_ready(),
            ],
            repeats,
        )
        rate = count * _update_operations(ddpg, batch_size) / update_seconds
        peak = 2 * size**3 / product_seconds
        name = f"update, {len(ddpg.hidden_layers)} x {ddpg.hidden_layers[0]}, batch {batch_size}"
        figures += [
            Figure(f"{name} / matrix product", rate / peak, "", low=0.5),
            Figure("  one update", 1e3 * update_seconds / count, "ms"),
        ]
    return [*figures, Figure("  matrix product", peak / 1e9, "GFLOP/s")]


def _update_operations(ddpg: Any, batch_size: int) -> float:
    """Floating-point operations in the matrix products of one update, on average."""

    def products(input_size: int, output_size: int) -> int:
        widths = [input_size, *ddpg.hidden_layers, output_size]
        return sum(a * b for a, b in itertools.pairwise(widths))

    actor = products(ddpg.input_size, ddpg.action_size)
    critic = products(ddpg.input_size + ddpg.action_size, 1)
    # Targets: one pass each. Critic loss: forward, and gradients to weights and activations.
    # Actor loss: the same for the actor; the critic forward, and its gradient to the action.
    of_actor = (actor * 3 + critic * 2) / ddpg.actor_update_every
    return 2.0 * batch_size * (actor + critic * (1 + 3) + of_actor)


def _measure_sweep(repeats: int) -> list[Figure]:
    """A sweep of 6 against 6 single runs, and what compiles after the first epoch."""
    import jax

    from cgm_jax.loop.environment import make_environment
    from cgm_jax.loop.programs import compilations, make_programs, stack_runs
    from cgm_jax.loop.training import Trainer

    group = _cpu_group("push", runs=6)
    settings = dataclasses.replace(group.settings, cycles_per_epoch=2)
    programs = make_programs(Trainer(make_environment(settings), settings))

    def trainer_of(runs: Sequence[Run]) -> Callable[[], None]:
        hyper = stack_runs(runs)
        states = [programs.start(hyper)]

        def epoch() -> None:
            state = programs.train(states.pop(), hyper, settings.cycles_per_epoch)
            state, _ = programs.evaluate(state, hyper)
            states.append(jax.block_until_ready(state))

        return epoch

    six, one = trainer_of(group.runs), trainer_of(group.runs[:1])
    for epoch in (six, one):
        epoch()
    before = compilations(programs)
    six_seconds, one_seconds = _medians([six, one], repeats)
    return [
        Figure(
            "sweep of 6 / 6 single runs, push, time", six_seconds / (6 * one_seconds), "", high=1.15
        ),
        Figure("compilations after the first epoch", compilations(programs) - before, "", high=0),
    ]


if __name__ == "__main__":
    run_program(main)
