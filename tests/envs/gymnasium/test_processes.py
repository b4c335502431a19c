"""Environments in processes of their own, by Gymnasium's AsyncVectorEnv."""

# Gymnasium leaves its spaces and environments untyped.
# pyright: reportAttributeAccessIssue=false, reportOptionalMemberAccess=false

import json
import multiprocessing
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from tests.envs.gymnasium.helpers import make, make_vec

PROGRAM = """
import sys
import cgm_jax, gymnasium

if __name__ == "__main__":
    if "a computation first" in sys.argv:
        import jax.numpy
        jax.numpy.ones(3).sum()
    if "an environment first" in sys.argv:
        gymnasium.make("cgm_jax/FetchReach-v0").reset()
    envs = gymnasium.make_vec(
        "cgm_jax/FetchReach-v0",
        num_envs=2,
        vectorization_mode="async",
        vector_kwargs={"context": sys.argv[1]},
    )
    observation, _ = envs.reset(seed=7)
    print(observation["desired_goal"].tolist())
    print(envs.step(envs.action_space.sample())[1].tolist())
    envs.close()
"""

can_fork = pytest.mark.skipif(
    "fork" not in multiprocessing.get_all_start_methods(), reason="this system has no fork"
)


def run(tmp_path: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    """The program above in a process without JAX; whatever hangs is over after two minutes."""
    file = tmp_path / "program.py"
    file.write_text(PROGRAM)
    return subprocess.run(
        [sys.executable, str(file), *arguments], capture_output=True, text=True, timeout=120
    )


@can_fork
def test_a_fork_is_refused_though_its_parent_has_made_no_environment_yet() -> None:
    program = """
import os
import cgm_jax, gymnasium, jax.numpy

jax.numpy.ones(3).sum()
child = os.fork()
if not child:
    try:
        gymnasium.make("cgm_jax/FetchReach-v0").reset(seed=0)
    except RuntimeError as error:
        os._exit(3 if "spawn" in str(error) else 4)
    os._exit(0)
print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))
"""
    result = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, timeout=120
    )
    assert result.stdout.split() == ["3"], result.stderr


@can_fork
def test_jax_starts_with_the_first_reset_and_a_fork_after_it_is_refused() -> None:
    program = """
import os
import cgm_jax, gymnasium

env = gymnasium.make("cgm_jax/FetchReach-v0")
env.unwrapped.data  # MuJoCo's, without JAX

def in_a_child() -> int:
    child = os.fork()
    if child:
        return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    try:
        env.reset(seed=0)
    except RuntimeError as error:
        os._exit(3 if "spawn" in str(error) else 4)
    os._exit(0)

print(in_a_child())
env.reset(seed=0)
print(in_a_child())
"""
    result = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, timeout=120
    )
    assert result.stdout.split() == ["0", "3"], result.stderr


@pytest.mark.slow
@pytest.mark.parametrize("context", multiprocessing.get_all_start_methods())
def test_async_environments_work_however_their_processes_start(
    tmp_path: Path, context: str
) -> None:
    result = run(tmp_path, context)
    assert result.returncode == 0, result.stderr
    goals, rewards = (np.array(json.loads(line)) for line in result.stdout.splitlines())
    alone = [make("FetchReach").reset(seed=seed)[0]["desired_goal"] for seed in (7, 8)]
    np.testing.assert_allclose(goals, alone, atol=1e-6)
    assert set(rewards) <= {-1.0, 0.0}


@can_fork
@pytest.mark.slow
@pytest.mark.parametrize("order", ["a computation first", "an environment first"])
def test_where_jax_would_hang_it_says_what_to_write(tmp_path: Path, order: str) -> None:
    result = run(tmp_path, "fork", order)
    assert result.returncode == 1
    assert result.stderr.splitlines()[-1].startswith("RuntimeError: JAX would hang")
    assert 'vector_kwargs={"context": "spawn"}' in result.stderr


@pytest.mark.slow
def test_spawned_environments_are_the_rows_of_a_batch() -> None:
    batch = make_vec("FetchPush", num_envs=2, max_episode_steps=3)
    spawned = make_vec(
        "FetchPush",
        num_envs=2,
        max_episode_steps=3,
        vectorization_mode="async",
        vector_kwargs={"context": "spawn"},
    )
    try:
        assert spawned.observation_space == batch.observation_space
        expected, _ = batch.reset(seed=5)
        observation, _ = spawned.reset(seed=5)
        generator = np.random.default_rng(0)
        for _ in range(6):  # past the end of an episode
            for name, rows in expected.items():
                np.testing.assert_allclose(observation[name], rows, atol=1e-6)
            actions = generator.uniform(-1, 1, (2, 4)).astype(np.float32)
            expected, *rest = batch.step(actions)
            observation, *others = spawned.step(actions)
            for one, other in zip(rest[:3], others[:3], strict=True):
                np.testing.assert_array_equal(one, other)
        assert spawned.get_attr("np_random_seed") == batch.np_random_seed == (5, 6)
    finally:
        spawned.close()
