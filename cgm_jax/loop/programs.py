"""The compiled programs of a group of runs: the trainer's functions, jitted and vmapped."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import jax

from cgm_jax.config.grid import Run
from cgm_jax.config.settings import Hyperparameters
from cgm_jax.loop.state import TrainingState, stack
from cgm_jax.loop.training import Metrics, Trainer


@dataclass(frozen=True)
class Programs:
    """One compiled program each, whatever the number of runs and the values they sweep.

    Attributes:
        trainer: whose programs these are.
        start: hyperparameters to states.
        train: states, hyperparameters and a number of cycles to states. Takes the states over:
            their buffers are reused.
        evaluate: states and hyperparameters to states and metrics; takes the states over.
    """

    trainer: Trainer
    start: Callable[[Hyperparameters], TrainingState]
    train: Callable[[TrainingState, Hyperparameters, int], TrainingState]
    evaluate: Callable[[TrainingState, Hyperparameters], tuple[TrainingState, Metrics]]


def make_programs(trainer: Trainer) -> Programs:
    """Jit and vmap a trainer over a leading axis of runs. Nothing compiles yet."""
    return Programs(
        trainer=trainer,
        start=jax.jit(jax.vmap(trainer.initial_state)),
        train=jax.jit(jax.vmap(trainer.train_cycles, in_axes=(0, 0, None)), donate_argnums=0),
        evaluate=jax.jit(jax.vmap(trainer.evaluate), donate_argnums=0),
    )


def stack_runs(runs: Sequence[Run]) -> Hyperparameters:
    """Hyperparameters of all runs, every leaf [runs]."""
    return stack([run.hyper for run in runs])


def compilations(programs: Programs) -> int:
    """How many programs XLA has compiled so far; at most three however long training goes on."""
    jitted = (programs.start, programs.train, programs.evaluate)
    return sum(program._cache_size() for program in jitted)  # pyright: ignore
