"""Cycles in parts, where `cutting.py` says so.

The parts are the steps of the rollout, each of all environments, and then the updates, some at a
time. What of a cycle is not finished lies in the training state.
"""

from collections.abc import Callable
from functools import partial
from typing import TypeVar

import jax
import jax.numpy as jnp
from flax import struct

from cgm_jax.config.settings import Hyperparameters
from cgm_jax.loop.cutting import WHOLE, Parts
from cgm_jax.loop.cycle import carry_out, cycle, plan, store, training_policy
from cgm_jax.loop.learning import learn_part, parts_of_updates
from cgm_jax.loop.rollout import PartialRollout, begin_rollout, finish_rollout, step_rollout
from cgm_jax.loop.setup import Setup, init_state
from cgm_jax.loop.state import TrainingState

Tree = TypeVar("Tree")


class Unfinished(struct.PyTreeNode):
    """A cycle that has begun, or what the last one has left.

    Attributes:
        done: parts that are done of it, int32; 0 before the first of a cycle.
        rollout: its episodes.
        draw_key, agent_key: sources of randomness of its updates.
    """

    done: jax.Array
    rollout: PartialRollout
    draw_key: jax.Array
    agent_key: jax.Array


def parts_of_cycle(setup: Setup, hyper: Hyperparameters) -> Parts:
    """How the cycles of a run are cut; `WHOLE` where they are not."""
    if not setup.is_cut:
        return WHOLE
    whole = getattr(setup.env, "states_are_whole", True)  # a hosted environment's are not
    rollout = setup.env.episode_length if whole else 1
    return Parts(rollout, parts_of_updates(setup, hyper))


def init_run(setup: Setup, hyper: Hyperparameters) -> TrainingState:
    """The state of a run before any training, with room for a cycle that is not finished.

    Raises:
        SettingError: see `init_state`.
    """
    state = init_state(setup, hyper)
    if not setup.is_cut:
        return state
    _, like = jax.eval_shape(partial(_begin, setup, hyper), state)
    return state.replace(unfinished=jax.tree.map(lambda x: jnp.zeros(x.shape, x.dtype), like))


def train_part(setup: Setup, state: TrainingState, hyper: Hyperparameters) -> TrainingState:
    """The next part of a cycle; all of it where cycles are whole."""
    if not setup.is_cut:
        return cycle(setup, state, hyper)
    parts = parts_of_cycle(setup, hyper)
    done = state.unfinished.done
    key, unfinished = _if(
        done == 0,
        lambda _: _begin(setup, hyper, state),
        (state.key, state.unfinished),
    )
    rollout = _if(
        done < parts.rollout,
        partial(_roll_on, setup, state, hyper, parts, done),
        unfinished.rollout,
    )
    unfinished = unfinished.replace(rollout=rollout, done=(done + 1) % parts.total)
    state = _if(
        done == parts.rollout - 1,
        lambda state: store(setup, state, hyper, finish_rollout(setup.env, rollout)),
        state.replace(key=key, unfinished=None),
    )
    state = _if(
        done >= parts.rollout,
        lambda state: learn_part(
            setup, state, hyper, unfinished.draw_key, unfinished.agent_key, done - parts.rollout
        ),
        state,
    )
    return state.replace(unfinished=unfinished)


def _begin(
    setup: Setup, hyper: Hyperparameters, state: TrainingState
) -> tuple[jax.Array, Unfinished]:
    """Plan a cycle: the key that is left, and a cycle of which nothing is done."""
    planned = plan(setup, state, hyper)
    rollout = carry_out(setup, state, hyper, planned, begin_rollout)
    done = jnp.zeros((), jnp.int32)
    return planned.key, Unfinished(done, rollout, planned.draw_key, planned.agent_key)


def _roll_on(
    setup: Setup,
    state: TrainingState,
    hyper: Hyperparameters,
    parts: Parts,
    done: jax.Array,
    rollout: PartialRollout,
) -> PartialRollout:
    """The steps of a part."""
    policy = training_policy(setup, state, hyper, rollout.goals)
    steps = setup.env.episode_length // parts.rollout
    return jax.lax.fori_loop(
        done * steps,
        (done + 1) * steps,
        lambda index, rollout: step_rollout(setup.env, policy, rollout, index),
        rollout,
    )


def _if(condition: jax.Array, function: Callable[[Tree], Tree], tree: Tree) -> Tree:
    """What a function makes of a pytree if a condition holds, else the same."""
    return jax.lax.cond(condition, function, lambda tree: tree, tree)
