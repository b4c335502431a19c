"""Every agent that comes with the package, trained for two tiny epochs, once per process."""

import functools
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from cgm_jax.config.components import builtin, component
from cgm_jax.config.fields import declared, stack
from cgm_jax.config.settings import Hyperparameters
from cgm_jax.loop.state import TrainingState
from cgm_jax.loop.training import Programs, make_programs, make_trainer
from cgm_jax.measuring.compilations import programs_compiled
from tests.cgm_jax.probe import TINY, tiny
from tests.examples.point_mass import PointMass

AGENTS = sorted(builtin("agent"))


class Trained(NamedTuple):
    """Runs that one program trained side by side, and their states on the host.

    Attributes:
        programs: their programs.
        names: what each run has changed: nothing (""), a traced setting to half its value, or a
            learning rate to one with which it diverges.
        hyper: settings of the runs, every leaf [runs].
        start: before any training.
        first, second: after so many epochs.
        failure: of each run after both.
        logged: of each run, updates of the second epoch whose losses are logged.
        compiled_later: programs that were compiled in the second epoch.
    """

    programs: Programs
    names: list[str]
    hyper: Hyperparameters
    start: TrainingState
    first: TrainingState
    second: TrainingState
    failure: np.ndarray
    logged: np.ndarray
    compiled_later: int


@functools.cache
def trained(agent: str) -> Trained:
    """Train an agent on the point mass, once with each traced setting changed."""
    runs = {"": tiny(agent=agent)}
    for item in declared(component("agent", agent)):
        if item.metadata["traced"]:
            half = 0.5 * getattr(runs[""].agent, item.name)
            runs[item.name] = tiny(agent=agent, **{item.name: half})
        if item.name.endswith("learning_rate"):
            runs[f"diverging {item.name}"] = tiny(agent=agent, **{item.name: 1e30})
    hyper = stack(list(runs.values()))
    programs = make_programs(make_trainer(PointMass(), TINY))

    def epoch(state: TrainingState) -> tuple[TrainingState, np.ndarray, np.ndarray]:
        state = programs.train(programs.spread(on_host(state)), hyper, 2)
        logged = np.array(state.statistics.updates)  # before `evaluate` sets it to 0
        state, metrics = programs.evaluate(state, hyper)
        return on_host(state), np.asarray(metrics["failure"]), logged

    start = on_host(programs.start(hyper))
    first, *_ = epoch(start)
    before = programs_compiled()
    second, failure, logged = epoch(first)
    later = programs_compiled() - before
    return Trained(programs, list(runs), hyper, start, first, second, failure, logged, later)


def on_host(state: TrainingState) -> TrainingState:
    """A copy whose buffers no program takes over; the key stays a key."""
    return jax.tree.map(lambda leaf: leaf.copy() if is_key(leaf) else np.array(leaf), state)


def bits(tree: Any) -> list[np.ndarray]:
    """All leaves as numbers, keys too."""
    return [
        np.asarray(jax.random.key_data(leaf) if is_key(leaf) else leaf)
        for leaf in jax.tree.leaves(tree)
    ]


def is_key(leaf: Any) -> bool:
    """Whether a leaf is a key of JAX's."""
    return jnp.issubdtype(leaf.dtype, jax.dtypes.prng_key)
