"""How much memory a group of runs will take, and how many runs fit.

XLA would tell to the byte, but only after compiling for that number of runs. So its plan is
modelled: what a program holds besides the state is the largest of its phases, each a multiple
of something whose shape is known. The multiples were read from XLA's own analysis of the
compiled programs (jax 0.10.2); tests hold the sum within 15 % of what a process takes.

That holds where a step of the environment is a callback, as of MuJoCo, or up to 2,000 operations.
Physics that XLA compiles, such as Brax's and MJX's, may take as much again, most of it while they
are compiled, which XLA's analysis of a program does not tell either. It is said not to be counted,
nor is the other process of environments that are Gymnasium's.
"""

import itertools
from dataclasses import dataclass
from functools import partial
from typing import Any

import jax

from cgm_jax.config.fields import SettingError
from cgm_jax.config.settings import Hyperparameters
from cgm_jax.envs import GoalEnvironment
from cgm_jax.loop.devices import share
from cgm_jax.loop.environment import compiles_physics, is_hosted
from cgm_jax.loop.learning import minibatches
from cgm_jax.loop.setup import sizes
from cgm_jax.loop.training import Trainer
from cgm_jax.machine.allotment import free_memory

USABLE_SHARE = 0.8
"""Share of the free memory that a sweep may plan with."""

PROCESS_BYTES = 860 * 2**20
"""Host memory whatever the sweep: libraries (280 MiB), compiling (550: from 470, where it is soon
done, to 620 on one core, where it goes on beside training), checkpoints, threads.
"""

NOT_COUNTED = ", and more for its physics: what XLA takes to compile and run them is not counted"
"""What to add to an estimate where an environment `compiles_physics`."""

SIMULATORS_NOT_COUNTED = ", and more for its simulators, one per episode at once: not counted"
"""And where it `is_hosted`."""

TRAINING_COPIES = 4
"""Of a cycle's episodes: step by step, whole, with noise, and inside the normaliser."""

EVALUATION_COPIES = 1
MINIBATCH_COPIES = 2
"""Before and after normalisation."""

LAYER_COPIES = 5.3
"""Of what the hidden units of one network hold for a batch: two networks there and back."""


def not_counted(env: GoalEnvironment) -> str:
    """What to add to an estimate, that it leaves out for an environment; often nothing."""
    if is_hosted(env):
        return SIMULATORS_NOT_COUNTED
    return NOT_COUNTED if compiles_physics(env) else ""


@dataclass(frozen=True)
class MemoryEstimate:
    """Bytes that a group of runs takes on each device; on a CPU, the whole process.

    Attributes:
        fixed: whatever the number of runs.
        state: per run, the training state.
        rollout, evaluation, minibatches, update: per run, further phases of the programs, of which
            only one holds memory at a time.
        parts: per run, the setting that decides each part of it, with its bytes.
        on_cpu: devices share the memory, and train their runs one after another, each in a copy of
            its state. If it is one, the idle device beside it holds as many states.
    """

    fixed: int
    state: int
    rollout: int
    evaluation: int
    minibatches: int
    update: int
    parts: dict[str, int]
    on_cpu: bool = False

    def total(self, runs: int, devices: int = 1) -> int:
        """Bytes for so many runs at once: on the fullest device, or on all where they share it."""
        sharing, runs = share(runs, devices)
        phase = max(self.rollout, self.evaluation, self.minibatches, self.update)
        if not self.on_cpu:
            return self.fixed + runs * (self.state + phase)
        return self.fixed + max(2, sharing) * runs * self.state + sharing * (self.state + phase)


def estimate_memory(trainer: Trainer, hyper: Hyperparameters) -> MemoryEstimate:
    """What training takes, from the shapes of what it holds.

    Args:
        trainer: of the runs.
        hyper: of one of them; its structure counts.
    """
    setup = trainer.setup
    settings = setup.settings
    state = jax.eval_shape(trainer.init, hyper)
    key = jax.eval_shape(jax.random.key, 0)
    drawn = jax.eval_shape(partial(minibatches, setup), state, hyper, key)
    ring = tree_bytes(state.replay.episodes)
    episode = ring // state.replay.episodes.mask.shape[0]
    hidden = _hidden_widths(hyper.agent, state.agent)
    step = 2 * tree_bytes(setup.like) + 4 * sum(sorted(hidden)[-2:])  # before and after
    rollout = settings.environments * (TRAINING_COPIES * episode + step)
    examined = hyper.curriculum.examination(sizes(setup, hyper))
    episodes = max(settings.evaluation_episodes, 0 if examined is None else len(examined))
    evaluation = episodes * (EVALUATION_COPIES * episode + step)
    agent, batches = tree_bytes(state.agent), tree_bytes(drawn)
    layers = int(LAYER_COPIES * 4 * settings.batch_size * sum(hidden))
    on_cpu = setup.platform == "cpu"  # which updates one run after the other
    return MemoryEstimate(
        fixed=PROCESS_BYTES if on_cpu else 0,
        state=tree_bytes(state),
        rollout=rollout,
        evaluation=evaluation,
        minibatches=MINIBATCH_COPIES * batches,
        update=batches + agent + layers + agent,
        parts={
            "replay_transitions": ring,
            "environments": rollout,
            "evaluation_episodes": evaluation,
            "batch_size": MINIBATCH_COPIES * batches + layers,
            "hidden_layers": 3 * agent,
            "curriculum": tree_bytes(state.curriculum),
        },
        on_cpu=on_cpu,
    )


def _hidden_widths(agent: Any, state: Any) -> list[int]:
    """Widths of the hidden layers of an agent's actor, from shapes of its state."""
    layers = jax.eval_shape(agent.actor, state)["params"]
    return [layers[f"layer_{i}"]["bias"].shape[-1] for i in range(len(layers) - 1)]


def runs_that_fit(estimate: MemoryEstimate, runs: int, devices: int = 1) -> int:
    """How many of `runs` runs fit at once on so many devices.

    A single run that would take more than is planned with, but not more than there is, is tried.

    Raises:
        SettingError: a single run takes more than there is.
    """
    free = free_bytes()
    if estimate.total(1) > free:
        # No setting helps where there is no room for the libraries and the compiler.
        too_small = estimate.fixed > free
        largest = "memory" if too_small else max(estimate.parts, key=estimate.parts.__getitem__)
        raise SettingError(
            f"{largest}: one run takes {format_bytes(estimate.total(1))} of memory, "
            f"and {format_bytes(free)} are free"
        )
    # One run more may take less in all, where it divides the devices better; so the most so far.
    totals = (estimate.total(number, devices) for number in range(1, runs + 1))
    most = itertools.accumulate(totals, max)
    return max(1, sum(1 for _ in itertools.takewhile((free * USABLE_SHARE).__ge__, most)))


def format_bytes(count: int) -> str:
    """A number of bytes for people."""
    return f"{count / 2**20:,.1f} MiB" if count < 2**30 else f"{count / 2**30:,.1f} GiB"


def tree_bytes(tree: object) -> int:
    """Bytes of all arrays in a pytree of arrays or shapes."""
    return sum(leaf.size * leaf.dtype.itemsize for leaf in jax.tree.leaves(tree))


def free_bytes() -> int:
    """Free memory of the fullest device that JAX computes on; of the host if that is the CPU."""
    known = [device.memory_stats() for device in jax.local_devices()]
    if not all(statistics and "bytes_limit" in statistics for statistics in known):
        return free_memory()
    return min(found["bytes_limit"] - found.get("bytes_in_use", 0) for found in known if found)
