"""The end of an epoch: noise-free episodes, and what metrics.jsonl is to hold."""

from typing import Any

import jax
import jax.numpy as jnp

from cgm_jax.agents.networks import apply_actor
from cgm_jax.config.missing import missing
from cgm_jax.config.settings import Hyperparameters
from cgm_jax.curricula.protocol import Goals
from cgm_jax.loop.exploration import Exploration
from cgm_jax.loop.inputs import network_inputs
from cgm_jax.loop.rollout import Policy, Rollout, drawn_goals, reset, roll_out
from cgm_jax.loop.setup import Setup, sizes
from cgm_jax.loop.state import EpochStatistics, TrainingState, count_true, init_statistics

Metrics = dict[str, jax.Array]


def evaluate(
    setup: Setup, state: TrainingState, hyper: Hyperparameters
) -> tuple[TrainingState, Metrics]:
    """Close an epoch: noise-free episodes with the full goal, and the epoch's metrics.

    Tells the curriculum what came of them, starts new epoch statistics, and returns, per run, what
    metrics.jsonl holds. What the curriculum reports is what the epoch was trained with, so before
    this evaluation. Evaluation steps do not count as `env_steps`.
    """
    changed, metrics = changes_of_evaluation(setup, state, hyper)
    return state.replace(**changed), metrics


def changes_of_evaluation(
    setup: Setup, state: TrainingState, hyper: Hyperparameters
) -> tuple[dict[str, Any], Metrics]:
    """Like `evaluate`, but of the state only the fields that change, by their names."""
    key, reset_key, examination_key = jax.random.split(state.key, 3)

    def played(key: jax.Array, count: int, masks: jax.Array | None = None) -> Rollout:
        first = reset(setup.env, key, count)
        goals = drawn_goals(setup.env, first)
        goals = goals if masks is None else goals.replace(mask=masks)
        return roll_out(setup.env, final_policy(setup, state, hyper, goals), first, goals)

    rollout = played(reset_key, setup.settings.evaluation_episodes)
    outcomes, valid = rollout.outcomes, rollout.outcomes.valid
    episodes = count_true(valid)
    broken, examined = count_true(rollout.broken), None
    masks = hyper.curriculum.examination(sizes(setup, hyper))
    if masks is not None:
        rollout = played(examination_key, len(masks), masks)
        examined = rollout.outcomes
        broken += count_true(rollout.broken)
    metrics = {
        "env_steps": state.env_steps,
        "updates": state.updates,
        "success_rate": _share(count_true(valid & outcomes.success), episodes),
        "evaluated_episodes": episodes.astype(jnp.int32),
        "subgoal_success": _share(
            count_true(valid[:, None] & outcomes.subgoal_success, axis=0), episodes
        ),
        **hyper.curriculum.report(state.curriculum),
        **_training_metrics(state.statistics, state.failure),
        "physics_warnings": state.statistics.physics_warnings + broken,
        "failure": state.failure,
    }
    changed = {
        "key": key,
        "curriculum": hyper.curriculum.after_evaluation(state.curriculum, outcomes, examined),
        "statistics": init_statistics(setup.masks, hyper.agent.logged),
    }
    return changed, metrics


def final_policy(
    setup: Setup, state: TrainingState, hyper: Hyperparameters, goals: Goals
) -> Policy:
    """The deterministic policy that is evaluated and exported."""
    actor = hyper.agent.actor(state.agent)

    def policy(observation: jax.Array, goal: jax.Array, noise: Exploration | None) -> jax.Array:
        del noise
        inputs = network_inputs(
            setup, hyper, state.normaliser, observation, goal, goals.mask, goals.threshold
        )
        return apply_actor(actor, inputs)

    return policy


def _training_metrics(statistics: EpochStatistics, failure: jax.Array) -> Metrics:
    updates = jnp.where(failure == 0, statistics.updates, 0.0)  # those of a frozen run lead nowhere
    losses = {name: _share(total, updates) for name, total in statistics.losses.items()}
    moved = {"moved_share": _share(statistics.moved_episodes, statistics.episodes)}
    if not statistics.mask_episodes.size:
        return moved | losses
    masks = {
        "mask_rate_training": _share(statistics.mask_successes, statistics.mask_episodes),
        "mask_share": _share(statistics.mask_episodes, statistics.episodes),
    }
    return masks | moved | losses


def _share(part: jax.Array, whole: jax.Array) -> jax.Array:
    """A share, or `missing` of nothing; without dividing 0 by 0."""
    return jnp.where(whole > 0, part / jnp.maximum(whole, 1), missing())
