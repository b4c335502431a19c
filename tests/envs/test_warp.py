"""MuJoCo Warp on a CPU: `make test-warp`, which installs it and compiles its kernels (minutes).

What its `forward` and `step` do on a GPU is the same source, compiled for another device.
"""

# Brax types the parts of its State as unknown, and warp is not installed where pyright runs.
# pyright: reportMissingImports=false, reportAttributeAccessIssue=false

import dataclasses
import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from cgm_jax import envs
from cgm_jax.envs.fetch import FetchEnvironment
from cgm_jax.envs.names import TASKS
from cgm_jax.envs.scene import load_scene
from cgm_jax.loop.rollout import drawn_goals, reset, roll_out
from experiments.physics.scripted import Player
from tests.envs.adversary import attack
from tests.envs.measures import object_speed, observations, warnings

pytest.importorskip("warp")

from cgm_jax.envs.physics.warp import WarpPhysics, most_contacts_and_constraints

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def player() -> Player:
    return Player(envs.make("push", engine="warp"))


def cramped(**room: int) -> FetchEnvironment:
    env = envs.make("push", engine="native")
    return dataclasses.replace(env, physics=WarpPhysics(env.scene, **room))


@pytest.mark.parametrize("task", ["push", "pick_and_place"])
def test_it_does_as_c_mujoco_does_and_prints_nothing(task: str) -> None:
    process = subprocess.run(
        [sys.executable, "-m", "tests.envs.engine_checks", task, "warp"],
        capture_output=True,
        text=True,
        cwd=ROOT,
        env=dict(os.environ),
        timeout=580,
    )
    assert process.returncode == 0, process.stderr
    assert process.stderr == ""
    (line,) = process.stdout.splitlines()
    found: dict[str, Any] = json.loads(line)
    assert found["moved"] > 0.04
    assert found["lowest"] > 0.42
    # 1.6 mm were seen after 50 steps, ten times what MJX strays; why is not known.
    assert found["strayed"] < 3e-3
    assert found["success"] >= 0.95
    assert found["same_outcome"] >= 0.95
    if task == "pick_and_place":
        assert found["lifted"] > 0.8
    assert found["finite"]
    assert found["warnings"] == 0
    assert found["object_speed"] < 5.0
    assert found["finger_depth"] < 0.025


@pytest.mark.parametrize("environments", [1, 8, 512])
def test_there_is_room_for_whatever_adversaries_do(player: Player, environments: int) -> None:
    states = player.play(attack, environments)
    assert warnings(states) == 0
    assert np.isfinite(observations(states)).all()
    assert object_speed(states).max() < 5.0


def test_room_is_for_every_pair_of_geoms_at_once() -> None:
    model = load_scene(TASKS["push"]).model
    # Seven pairs of eight contacts each; a weld, and what else is neither contact nor weld.
    contacts, rows = most_contacts_and_constraints(model)
    assert contacts == 7 * 8
    assert rows == 306


def test_rows_of_runs_and_environments_are_one_batch(player: Player) -> None:
    states, env = player.play(attack, 8), player.env
    flat, nested = jax.jit(jax.vmap(env.step)), jax.jit(jax.vmap(jax.vmap(env.step)))
    moved = 0.0
    for step in range(2, 50, 4):
        state, observed = states[step], np.asarray(states[step].obs["observation"])
        action = jnp.asarray(attack(observed, np.zeros((8, 3)), step))
        expected = flat(state, action)
        runs = jax.tree.map(lambda x: x.reshape(2, 4, *x.shape[1:]), (state, action))
        after = jax.tree.map(lambda x: x.reshape(8, *x.shape[2:]), nested(*runs))
        np.testing.assert_allclose(after.obs["observation"], expected.obs["observation"], atol=1e-5)
        assert warnings([after]) == 0
        moved = max(moved, np.abs(np.asarray(expected.obs["observation"]) - observed).max())
    assert moved > 1e-2


def test_reach_is_learned(tmp_path: Path) -> None:
    out = tmp_path / "out"
    words = ["--preset", "cpu", "--env", "reach", "--engine", "warp", "--epochs", "1"]
    subprocess.run(
        [sys.executable, "-m", "cgm_jax.train", *words, "--out", str(out)], check=True, cwd=ROOT
    )
    (row,) = [json.loads(line) for line in (out / "metrics.jsonl").read_text().splitlines()]
    assert row["env_steps"] == 20_000
    assert row["success_rate"] >= 0.9


@pytest.mark.parametrize("room", [{"contacts": 1}, {"constraints": 20}])
def test_what_does_not_fit_is_a_physics_warning_and_drops_the_episode(room: dict[str, int]) -> None:
    env = cramped(**room)
    first = jax.jit(lambda key: reset(env, key, 4))(jax.random.key(0))
    goals = drawn_goals(env, first)

    def press_down(*_: Any) -> jax.Array:
        return jnp.broadcast_to(jnp.array([0.0, 0.0, -1.0, -1.0]), (4, 4))

    outcomes = jax.jit(lambda first: roll_out(env, press_down, first, goals).outcomes)(first)
    assert not np.asarray(outcomes.valid).any()
