import dataclasses
import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import jax
import pytest

from cgm_jax import envs
from cgm_jax.config.fields import SettingError, stack
from cgm_jax.config.grid import build_groups, run_of
from cgm_jax.envs.hosted.task import HostedTask
from cgm_jax.host import jobs as planning
from cgm_jax.host import memory
from cgm_jax.host.memory import (
    NOT_COUNTED,
    MemoryEstimate,
    estimate_memory,
    format_bytes,
    free_bytes,
    not_counted,
    runs_that_fit,
    tree_bytes,
)
from cgm_jax.loop import own_checks
from cgm_jax.loop.environment import compiles_physics
from cgm_jax.loop.training import make_programs, make_trainer
from tests.cgm_jax.probe import TINY, tiny
from tests.cgm_jax.sweeps import ROOT
from tests.examples.point_mass import PointMass


def test_the_replay_buffer_is_counted_to_the_byte() -> None:
    state = jax.eval_shape(make_trainer(PointMass(), TINY).init, tiny())
    # 40 episodes of 25 steps: observation 4 and goal 2 at 26 steps, action 2; goal, mask, and
    # threshold.
    floats = 40 * (26 * (4 + 2) + 25 * 2 + 2 + 2 + 1)
    assert tree_bytes(state.replay) == 4 * (floats + 1)


def test_the_parts_of_a_run_by_hand() -> None:
    trainer = make_trainer(PointMass(), TINY)
    estimate = estimate_memory(trainer, tiny())
    episode = 4 * (26 * (4 + 2) + 25 * 2 + 2 + 2 + 1)
    step = 2 * 4 * (4 + 2 + 2 + 2) + 4 * (16 + 16)  # the environment, reward and done; layers
    assert estimate.rollout == TINY.environments * (4 * episode + step)
    assert estimate.evaluation == TINY.evaluation_episodes * (episode + step)
    measured = tiny(masked_evaluation_episodes=7)  # of each of four masks
    assert estimate_memory(trainer, measured).evaluation == 28 * (episode + step)
    minibatches = 4 * TINY.updates_per_cycle * TINY.batch_size * (2 * (4 + 2) + 2 + 1)
    assert estimate.minibatches == 2 * minibatches
    actor = 6 * 16 + 16 + 16 * 16 + 16 + 16 * 2 + 2
    critic = 8 * 16 + 16 + 16 * 16 + 16 + 16 * 1 + 1
    # Networks, targets and two moments each; a counter per optimiser, and one of updates.
    agent = 4 * (4 * (actor + critic) + 3)
    layers = int(5.3 * 4 * TINY.batch_size * 32)
    assert estimate.update == minibatches + agent + layers + agent


def test_phases_do_not_add_up() -> None:
    estimate = MemoryEstimate(1000, 10, 5, 6, 7, 3, {})
    assert estimate.total(1) == 1000 + 10 + 7
    assert estimate.total(100) == 1000 + 100 * (10 + 7)
    assert estimate.total(100, devices=3) == 1000 + 34 * (10 + 7)  # the fullest of them


def test_on_a_cpu_runs_take_turns_in_a_copy_of_their_state() -> None:
    estimate = MemoryEstimate(1000, 10, 5, 6, 7, 3, {}, on_cpu=True)
    assert estimate.total(1) == 1000 + 2 * 10 + 10 + 7  # an idle device beside it
    assert estimate.total(3, devices=2) == 1000 + 2 * 2 * 10 + 2 * (10 + 7)  # one row left over
    assert estimate.total(8, devices=4) == 1000 + 4 * 2 * 10 + 4 * (10 + 7)


CASES = {
    "minibatches": {"updates_per_cycle": 40, "batch_size": 1024},
    "late actor": {"updates_per_cycle": 40, "batch_size": 1024, "actor_update_every": 40},
    "rollouts": {"environments": 2048, "replay_transitions": 1000, "hidden_layers": (64, 64)},
    "networks": {"hidden_layers": (768, 768), "updates_per_cycle": 2},
}


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES)
def test_the_model_of_each_phase_against_xlas_own_plan(case: str) -> None:
    values = {"hidden_layers": (16, 16), **dataclasses.asdict(TINY), **CASES[case]}
    settings, run = run_of(case, values)
    trainer, runs = make_trainer(PointMass(), settings), 4
    programs, hyper = make_programs(trainer), stack([run.hyper] * runs)
    state = jax.eval_shape(programs.start, hyper)
    plan = programs.train.lower(state, hyper, 1).compile().memory_analysis()  # pyright: ignore
    estimate = estimate_memory(trainer, run.hyper)
    idle = runs * estimate.state  # of a second device, which this process has not
    modelled = estimate.total(runs) - estimate.fixed - idle
    actual = plan.argument_size_in_bytes + plan.temp_size_in_bytes
    assert modelled == pytest.approx(actual, rel=0.35)


@pytest.mark.slow
@pytest.mark.parametrize("env", ["push", "tests/examples/point_mass.py:PointMass"])
def test_a_sweep_takes_what_was_said_beforehand(env: str, tmp_path: Path) -> None:
    # Memory of the process at its peak, with everything: libraries, compiling, training.
    program = (
        "import re, resource, sys; from cgm_jax.sweep import main; main(sys.argv[1:]);"
        "print(re.search(r'VmHWM:\\s+(\\d+)', open('/proc/self/status').read())[1])"
    )
    options = ["--preset", "cpu", "--env", env, "--epochs", "2", "--cycles-per-epoch", "2"]
    options += ["--seeds", "8", "--batch-size", "512", "--replay-transitions", "400000"]
    options += ["--out", str(tmp_path / "out"), "--updates-per-cycle", "20"]
    # Compiling is at the peak, so that it is to be as in users' processes.
    environment = {**os.environ, "JAX_ENABLE_COMPILATION_CACHE": "false"}
    del environment["XLA_FLAGS"]
    result = subprocess.run(
        [sys.executable, "-c", program, *options],
        capture_output=True,
        text=True,
        cwd=ROOT,
        env=environment,
        check=True,
    )
    actual = int(result.stdout.split()[-1]) / 1024
    said = re.search(r": ([\d.,]+) ([MG])iB(?: on \d+ devices)?$", result.stderr, re.MULTILINE)
    assert said is not None
    estimate = float(said[1].replace(",", "")) * (1024 if said[2] == "G" else 1)
    assert estimate == pytest.approx(actual, rel=0.15)


def test_what_is_free_is_within_what_a_machine_has() -> None:
    assert 2**26 < free_bytes() < 2**50


ESTIMATE = MemoryEstimate(100, 10, 0, 0, 0, 0, {"replay_transitions": 9, "batch_size": 1})


@pytest.mark.parametrize(("free", "fit"), [(10_000, 50), (250, 10), (130, 1), (115, 1)])
def test_runs_that_fit(monkeypatch: pytest.MonkeyPatch, free: int, fit: int) -> None:
    monkeypatch.setattr(memory, "free_bytes", lambda: free)
    assert runs_that_fit(ESTIMATE, 50) == fit


def test_what_fits_is_told_by_the_most_that_fewer_runs_take(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    estimate = MemoryEstimate(0, 1, 10, 0, 0, 0, {"environments": 1}, on_cpu=True)
    # Four runs divide three devices better than three do, on two of which they then train.
    totals = [estimate.total(runs, devices=3) for runs in range(1, 7)]
    assert totals == [13, 24, 36, 26, 39, 39]
    monkeypatch.setattr(memory, "free_bytes", lambda: 39)
    assert 26 < 39 * memory.USABLE_SHARE < 36
    assert runs_that_fit(estimate, 6, devices=3) == 2


@pytest.mark.parametrize(("free", "name"), [(109, "replay_transitions"), (99, "memory")])
def test_a_run_that_cannot_fit_is_refused_by_what_makes_it_large(
    free: int, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(memory, "free_bytes", lambda: free)
    with pytest.raises(SettingError, match=f"^{name}: one run takes"):
        runs_that_fit(ESTIMATE, 50)


@pytest.mark.parametrize(
    "setting",
    [
        "replay_transitions=10_000_000_000",
        "environments=1_000_000",
        "evaluation_episodes=1_000_000",
        "batch_size=10_000_000",
        "epochs=1_000_000_000",
    ],
)
def test_settings_of_absurd_size_are_refused_by_name_before_anything_compiles(
    setting: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    name, _, value = setting.partition("=")
    monkeypatch.setattr(memory, "free_bytes", lambda: 2 * 2**30)
    groups = build_groups("smoke", {name: [int(value)], "engine": ["native"]})
    with pytest.raises(SettingError, match=f"^{name}: "):
        planning.plan_jobs(groups, jax.devices())


def test_a_grid_that_does_not_fit_is_split_and_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    (group,) = build_groups("smoke", {"seed": list(range(5)), "kappa": [4.0], "engine": ["native"]})
    monkeypatch.setattr(planning, "runs_that_fit", lambda *_: 2)
    jobs, (note,) = planning.plan_jobs([group], jax.devices()[:1])
    assert [len(job.group.runs) for job in jobs] == [2, 2, 1]
    assert note.startswith("reach: memory for 5 runs, 2 at a time: ")
    assert len({id(job.programs) for job in jobs}) == 1
    # A plan that a directory has recorded stays, whatever the memory is today.
    monkeypatch.setattr(planning, "runs_that_fit", lambda *_: 5)
    again, _ = planning.plan_jobs([job.group for job in jobs], jax.devices()[:1], planned=True)
    assert [job.group for job in again] == [job.group for job in jobs]
    assert len({id(job.programs) for job in again}) == 1


@pytest.mark.parametrize(("few", "large"), [(2_000, False), (10, True)])
def test_physics_that_xla_compiles_are_said_not_to_be_counted(
    few: int, large: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(own_checks, "FEW_OPERATIONS", few)
    name = f"{ROOT}/tests/examples/point_mass.py:PointMass"
    groups = build_groups("smoke", {"env": [name], "kappa": [4.0]})
    (_, (note,)) = planning.plan_jobs(groups, jax.devices())
    assert note.endswith(f"iB{NOT_COUNTED if large else ''}")
    assert NOT_COUNTED.endswith("is not counted")


def test_simulators_in_another_process_are_said_not_to_be_counted() -> None:
    hosted: Any = object.__new__(HostedTask)  # one that no process stands behind
    hosted.action_size, hosted.episode_length, hosted.distance_threshold = 4, 50, 0.05
    assert "more for its simulators" in not_counted(hosted)
    assert not_counted(PointMass()) == ""


@pytest.mark.parametrize(("engine", "compiled"), [("native", False), ("mjx", True)])
def test_mjx_is_compiled_and_mujoco_is_called(engine: str, compiled: bool) -> None:
    assert compiles_physics(envs.make("reach", engine=engine)) is compiled


def test_sizes_for_people() -> None:
    assert format_bytes(3 * 2**19) == "1.5 MiB"
    assert format_bytes(5 * 2**29) == "2.5 GiB"
