"""Training as pure functions over a `TrainingState`, to be jitted and vmapped over runs.

    trainer = make_trainer(env, Settings(...))
    hyper = Hyperparameters(seed=0, curriculum=CGM(c_g=0.1), agent=DDPG())
    state = trainer.init(hyper)
    state, metrics = trainer.epoch(state, hyper)

One run is a sweep of one: `jax.vmap` the same functions over states and hyperparameters.
"""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from cgm_jax.config.settings import Hyperparameters, Settings
from cgm_jax.envs import GoalEnvironment
from cgm_jax.loop.cutting import Parts
from cgm_jax.loop.cycle import cycle
from cgm_jax.loop.devices import (
    ON_EACH,
    SPREAD,
    Device,
    on_each,
    own_rows,
    spread,
    spread_shapes,
    team_of,
)
from cgm_jax.loop.environment import calls_physics, compiler_options
from cgm_jax.loop.evaluation import Metrics, changes_of_evaluation, evaluate
from cgm_jax.loop.in_turn import in_place, in_turn
from cgm_jax.loop.parts import init_run, parts_of_cycle, train_part
from cgm_jax.loop.setup import Setup, make_setup
from cgm_jax.loop.state import TrainingState


class Trainer(NamedTuple):
    """Pure functions of one run; what shapes them is fixed.

    Attributes:
        setup: the environment and the static settings.
        init: from hyperparameters to the state before any training.
        parts: how the cycles of a run are cut, see `cutting.py`.
        train: so many cycles, or parts of them where they are cut; then each part computes, under
            `jax.vmap`, what all kinds of parts do.
        evaluate: close an epoch: noise-free episodes, and its metrics.
        epoch: `cycles_per_epoch` cycles, then `evaluate`.
    """

    setup: Setup
    init: Callable[[Hyperparameters], TrainingState]
    parts: Callable[[Hyperparameters], Parts]
    train: Callable[[TrainingState, Hyperparameters, int | jax.Array], TrainingState]
    evaluate: Callable[[TrainingState, Hyperparameters], tuple[TrainingState, Metrics]]
    epoch: Callable[[TrainingState, Hyperparameters], tuple[TrainingState, Metrics]]


def make_trainer(env: GoalEnvironment, settings: Settings, platform: str | None = None) -> Trainer:
    """The functions that train on an environment; nothing is run or compiled yet.

    Nothing of them asks what the process runs on: a machine without a GPU can lower what one with
    a GPU would, if it names the `platform` ("gpu"). None: what JAX computes on.

    Whether a run's curriculum and agent go with them, `init` says; `jax.eval_shape` of it does so
    without running it.
    """
    setup = make_setup(env, settings, platform)
    return Trainer(
        setup=setup,
        init=partial(init_run, setup),
        parts=partial(parts_of_cycle, setup),
        train=partial(train, setup),
        evaluate=partial(evaluate, setup),
        epoch=partial(epoch, setup),
    )


def train(
    setup: Setup, state: TrainingState, hyper: Hyperparameters, count: int | jax.Array
) -> TrainingState:
    """Any number of cycles, or of their parts: one loop whose length may be traced.

    So one program serves chunks of all lengths, and chunks give the bits of one whole.
    """
    return jax.lax.fori_loop(0, count, lambda _, state: train_part(setup, state, hyper), state)


def epoch(
    setup: Setup, state: TrainingState, hyper: Hyperparameters
) -> tuple[TrainingState, Metrics]:
    """One epoch: `cycles_per_epoch` cycles, of which one may have begun, and an evaluation."""
    count = setup.settings.cycles_per_epoch
    if setup.is_cut:
        # The rest in one go: under `jax.vmap` each part computes what all kinds of parts do.
        begun, parts = state.unfinished.done, parts_of_cycle(setup, hyper).total
        count -= jnp.where(begun > 0, 1, 0)
        state = train(setup, state, hyper, -begun % parts)
    state = jax.lax.fori_loop(0, count, lambda _, state: cycle(setup, state, hyper), state)
    return evaluate(setup, state, hyper)


SELDOM_RUN = {"xla_backend_optimization_level": 0, "xla_cpu_use_fusion_emitters": False}
"""XLA's options for what a CPU runs seldom: it compiles in less than half the time, and runs no
slower where physics and matrix products, which are libraries, take all of it. What XLA compiles of
an environment would run many times slower, or compile for minutes. They outrank XLA_FLAGS.
"""


class Programs(NamedTuple):
    """A trainer's functions, jitted, over a leading axis of runs that devices share.

    One compiled program each per number of runs and structure of their settings, whatever the
    values that they sweep.

    Attributes:
        trainer: whose programs these are.
        spread: states from a file to what the others take: on the devices, padded.
        shapes: hyperparameters to mere shapes of the states that `start` makes.
        start: hyperparameters to states, [rows, ...]: the runs first, then padding.
        train: states, hyperparameters and a number of cycles to states, or of parts where cycles
            are cut. Takes the states over: their buffers are reused.
        evaluate: states and hyperparameters to states and metrics; takes the states over.
    """

    trainer: Trainer
    spread: Callable[[Any], Any]
    shapes: Callable[[Hyperparameters], TrainingState]
    start: Callable[[Hyperparameters], TrainingState]
    train: Callable[[TrainingState, Hyperparameters, int], TrainingState]
    evaluate: Callable[[TrainingState, Hyperparameters], tuple[TrainingState, Metrics]]


def make_programs(trainer: Trainer, devices: Sequence[Device] | None = None) -> Programs:
    """Jit a trainer, over a leading axis of runs. Nothing compiles yet.

    Args:
        trainer: of each run.
        devices: that share the runs; by default the first one alone.
    """
    team, on_cpu = team_of(devices or jax.devices()[:1]), trainer.setup.platform == "cpu"

    def start(hyper: Hyperparameters) -> TrainingState:
        own, count = own_rows(team, hyper)
        return _over_rows(on_cpu, trainer.init, count)(own)

    def train(states: TrainingState, hyper: Hyperparameters, units: jax.Array) -> TrainingState:
        own, count = own_rows(team, hyper)
        one = partial(_train_for, trainer, units)
        return in_place(one, count)(states, own) if on_cpu else jax.vmap(one)(states, own)

    def evaluate(states: TrainingState, hyper: Hyperparameters) -> tuple[TrainingState, Metrics]:
        own, count = own_rows(team, hyper)
        one = partial(changes_of_evaluation, trainer.setup)  # the rest would be copied for nothing
        changed, metrics = _over_rows(on_cpu, one, count)(states, own)
        return states.replace(**changed), metrics

    usual = compiler_options(trainer.setup.env)
    seldom = SELDOM_RUN if on_cpu else usual
    starting = jax.jit(on_each(team, start, ON_EACH), compiler_options=seldom)
    return Programs(
        trainer=trainer,
        spread=partial(spread, team),
        shapes=lambda hyper: spread_shapes(team, jax.eval_shape(starting, hyper)),
        start=starting,
        train=jax.jit(
            on_each(team, train, SPREAD, ON_EACH, ON_EACH),
            donate_argnums=0,
            compiler_options=usual,
        ),
        evaluate=jax.jit(
            on_each(team, evaluate, SPREAD, ON_EACH),
            donate_argnums=0,
            compiler_options=seldom if calls_physics(trainer.setup.env) else usual,
        ),
    )


def _over_rows(on_cpu: bool, function: Callable[..., Any], count: jax.Array) -> Callable[..., Any]:
    return in_turn(function, count) if on_cpu else jax.vmap(function)


def _train_for(
    trainer: Trainer, units: jax.Array, state: TrainingState, hyper: Hyperparameters
) -> TrainingState:
    return trainer.train(state, hyper, units)
