"""Updates: minibatches from the replay ring, and the agent that learns from them."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jax.custom_batching import sequential_vmap

from cgm_jax.agents.protocol import Minibatch
from cgm_jax.config.fields import SettingError
from cgm_jax.config.settings import Hyperparameters
from cgm_jax.loop.divergence import freeze_if_failed
from cgm_jax.loop.inputs import network_inputs
from cgm_jax.loop.judging import may_end, reward_range, rewards
from cgm_jax.loop.setup import Setup, sizes
from cgm_jax.loop.state import TrainingState
from cgm_jax.replay.ring import size


def minibatches(
    setup: Setup, state: TrainingState, hyper: Hyperparameters, key: jax.Array
) -> Minibatch:
    """All minibatches of a cycle, or of a part of it, [updates, batch_size, ...].

    Replay and normaliser stay put during the updates, so that one draw serves them all.

    Raises:
        SettingError: the relabelling leaves out what the environment makes necessary.
    """
    updates, batch_size = sizes(setup, hyper).updates_at_once, setup.settings.batch_size
    drawn = hyper.relabelling.sample(
        key, state.replay, updates * batch_size, setup.env.distance_threshold, setup.stages
    )
    if may_end(setup.env) and drawn.continues is None:
        raise SettingError("relabelling: must fill continues, since env ends episodes")

    def see(observation: jax.Array, goal: jax.Array, subgoal: jax.Array | None) -> jax.Array:
        return network_inputs(
            setup, hyper, state.normaliser, observation, goal, drawn.mask, drawn.threshold, subgoal
        )

    prepared = Minibatch(
        inputs=see(drawn.observation, drawn.goal, drawn.subgoal),
        action=drawn.action,
        reward=rewards(setup.env, drawn),
        next_inputs=see(drawn.next_observation, drawn.next_goal, drawn.next_subgoal),
        continues=drawn.continues,
        reward_range=reward_range(setup.env),
    )
    return jax.tree.map(lambda rows: rows.reshape(updates, batch_size, *rows.shape[1:]), prepared)


def learn(
    setup: Setup,
    state: TrainingState,
    hyper: Hyperparameters,
    draw_key: jax.Array,
    agent_key: jax.Array,
) -> TrainingState:
    """Updates of a cycle, or of a part of it.

    An agent that diverges stays as it was before, and so it does while replay holds no episode.

    Raises:
        SettingError: the agent logs arrays of different lengths.
    """
    batches = minibatches(setup, state, hyper, draw_key)
    agent, info = _vmap_for_platform(setup.platform, _train)(
        hyper.agent, state.agent, batches, agent_key
    )
    learned = size(state.replay) > 0
    failure, agent = freeze_if_failed(state.failure, state.agent, agent, learned)
    losses = {
        name: total + jnp.where(learned, info[name].sum(), 0.0)
        for name, total in state.statistics.losses.items()
    }
    logged = {info[name].size for name in losses} or {0}
    if len(logged) > 1:
        raise SettingError("agent: what train logs are arrays of different lengths")
    updates = jnp.where(learned, len(batches.reward), 0)
    return state.replace(
        agent=agent,
        failure=failure,
        updates=state.updates + jnp.where(failure == 0, updates, 0),
        statistics=state.statistics.replace(
            losses=losses,
            updates=state.statistics.updates + jnp.where(learned, float(logged.pop()), 0.0),
        ),
    )


def parts_of_updates(setup: Setup, hyper: Hyperparameters) -> int:
    """In how many parts the updates of a cycle come."""
    return setup.settings.updates_per_cycle // sizes(setup, hyper).updates_at_once


def learn_part(
    setup: Setup,
    state: TrainingState,
    hyper: Hyperparameters,
    draw_key: jax.Array,
    agent_key: jax.Array,
    index: int | jax.Array,
) -> TrainingState:
    """Part `index` of a cycle's updates, whose minibatches are drawn for it alone.

    Args:
        setup: the environment and the static settings.
        state: of the run.
        hyper: of the run.
        draw_key: for the minibatches of all parts.
        agent_key: for what the agent draws in all parts.
        index: of the part.
    """
    keys = (jax.random.fold_in(key, index) for key in (draw_key, agent_key))
    return learn(setup, state, hyper, *keys)


def _train(agent: Any, state: Any, batches: Minibatch, key: jax.Array) -> Any:
    return agent.train(state, batches, key)


def _vmap_for_platform(platform: str, function: Callable[..., Any]) -> Callable[..., Any]:
    """On a CPU, let vmap run a function for one run after the other.

    One matrix product keeps all cores busy, and XLA's batched one costs 15 % more than its
    parts. A GPU needs the batch.
    """
    return sequential_vmap(function) if platform == "cpu" else function
