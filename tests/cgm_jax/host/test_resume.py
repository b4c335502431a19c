"""A sweep that was stopped or killed gives the bits of one that was not."""

import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from cgm_jax.storage.checkpoints import finished_checkpoints
from tests.cgm_jax.sweeps import (
    POINT_MASS,
    ROOT,
    assert_same_results,
    command,
    finish,
    rows,
    stop,
)

ALWAYS = ["--checkpoint-seconds", "0"]
NEVER = ["--checkpoint-seconds", "1e9"]


@pytest.mark.slow
def test_a_stopped_sweep_gives_the_bits_of_one_that_was_not(tmp_path: Path) -> None:
    grid = ["--env", "reach", "--engine", "native", "--epochs", "4", "--evaluation-episodes", "4"]
    whole, cut = tmp_path / "whole", tmp_path / "cut"
    finish(command(*grid, *NEVER, "--out", str(whole)))
    code, text = stop(command(*grid, *ALWAYS, "--out", str(cut)), after="epoch 2:")
    assert code == 75, text
    assert 4 <= len(rows(cut)) < 8
    assert list((cut / "policies").glob("*.npz"))
    finish(command(*grid, *NEVER, "--out", str(cut)))
    assert len(rows(cut)) == 8
    assert_same_results(whole, cut)


@pytest.mark.slow
def test_a_signal_in_the_middle_of_a_long_cycle_loses_nothing_of_it(tmp_path: Path) -> None:
    grid = ["--env", "reach", "--engine", "native", "--environments", "1024", "--seeds", "1"]
    grid += ["--kappa", "4", "--epochs", "3", "--cycles-per-epoch", "1"]
    whole, cut = tmp_path / "whole", tmp_path / "cut"
    finish(command(*grid, *NEVER, "--out", str(whole)))
    code, text = stop(command(*grid, *NEVER, "--out", str(cut)), after="epoch 1:", cpu_s=1.0)
    assert code == 75, text
    last = finished_checkpoints(cut / "checkpoints", 0)[-1]
    assert last.stem.startswith("group0_epoch000001_cycle000000_part")
    finish(command(*grid, *NEVER, "--out", str(cut)))
    assert_same_results(whole, cut)


MJX = """
import dataclasses, pathlib, sys
import jax, numpy as np
from cgm_jax import envs
from cgm_jax.host.checkpoint import TrainingProgress, load_checkpoint, save_checkpoint
from cgm_jax.config.settings import Hyperparameters
from cgm_jax.loop.training import make_programs, make_trainer
from cgm_jax.config.fields import stack
from tests.cgm_jax.probe import TINY, tiny

env = dataclasses.replace(envs.make("reach", engine="mjx"), episode_length=4)
settings = dataclasses.replace(TINY, environments=2, evaluation_episodes=2, replay_transitions=40)
programs = make_programs(make_trainer(env, settings))
hyper = stack([tiny(seed=0), tiny(seed=1)])

def epochs(state, count):
    history = []
    for _ in range(count):
        state, metrics = programs.evaluate(programs.train(state, hyper, 2), hyper)
        history.append(metrics)
    return state, history

def bits(tree):
    is_key = lambda leaf: jax.numpy.issubdtype(leaf.dtype, jax.dtypes.prng_key)
    leaves = [jax.random.key_data(x) if is_key(x) else x for x in jax.tree.leaves(tree)]
    return [np.asarray(leaf).tobytes() for leaf in leaves]

whole, metrics = epochs(programs.start(hyper), 4)
half, first = epochs(programs.start(hyper), 2)
directory, like = pathlib.Path(sys.argv[1]), jax.eval_shape(programs.start, hyper)
save_checkpoint(directory, 0, TrainingProgress(half))
training, _ = load_checkpoint(directory, 0, like)
again, second = epochs(training.state, 2)
assert bits(whole) == bits(again)
assert bits(metrics) == bits(first + second)
assert len(set(bits([entry["value"] for entry in metrics]))) == 4
print("same bits")
"""


@pytest.mark.slow
def test_mjx_goes_on_from_a_checkpoint_with_the_same_bits(tmp_path: Path) -> None:
    # In a process of its own, as MJX's flag must be set before JAX starts; and in only one, as
    # each would compile for a minute.
    program = [sys.executable, "-c", MJX, str(tmp_path)]
    result = subprocess.run(program, capture_output=True, text=True, cwd=ROOT, check=False)
    assert result.stdout == "same bits\n", result.stderr


@pytest.mark.slow
def test_kill_9_at_any_moment_loses_nothing_but_time(tmp_path: Path) -> None:
    grid = ["--env", POINT_MASS, "--epochs", "150", "--seeds", "1"]
    whole, killed = tmp_path / "whole", tmp_path / "killed"
    finish(command(*grid, *NEVER, "--out", str(whole)))
    draw = random.Random(0)
    first = command(*grid, *ALWAYS, "--out", str(killed))
    again = [*first[:3], "--resume", str(killed), *ALWAYS]
    for arguments in (first, again, first, again, again):
        epochs, delay = draw.randint(1, 25), draw.uniform(0, 0.1)
        with subprocess.Popen(arguments, stderr=subprocess.PIPE, text=True, cwd=ROOT) as process:
            assert process.stderr is not None
            for line in process.stderr:
                epochs -= line.startswith("epoch ")
                if epochs < 1:
                    break
            time.sleep(delay)
            process.kill()
            assert process.wait() == -signal.SIGKILL
    done = rows(killed)[-1]["epoch"]
    assert 1 < done < 150
    finish(again)
    assert len(rows(killed)) == 2 * 150
    assert_same_results(whole, killed)
