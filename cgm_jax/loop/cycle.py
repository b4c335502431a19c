"""A cycle: choose goals, roll out, store, learn."""

from collections.abc import Callable
from typing import Any, NamedTuple, TypeVar

import jax
import jax.numpy as jnp

from cgm_jax.config.settings import Hyperparameters
from cgm_jax.curricula.parts.masks import mask_indices
from cgm_jax.curricula.protocol import Curriculum, Goals, View
from cgm_jax.loop.exploration import Exploration, draw_exploration, explore
from cgm_jax.loop.inputs import network_inputs
from cgm_jax.loop.learning import learn, learn_part, parts_of_updates
from cgm_jax.loop.normaliser import observe
from cgm_jax.loop.rollout import Policy, Rollout, drawn_goals, reset, roll_out
from cgm_jax.loop.setup import Setup
from cgm_jax.loop.state import EpochStatistics, TrainingState, count_true
from cgm_jax.replay.future import moved_goal
from cgm_jax.replay.ring import insert, size, steps_taken

Result = TypeVar("Result")


class Plan(NamedTuple):
    """What a cycle is about to do.

    Attributes:
        key: source of all randomness after the cycle.
        first: states in which its episodes begin, leading axis [E].
        goals: what they are to achieve.
        exploration: noise for every step, leading axes [T, E].
        visit_key: see `roll_out`; None where the curriculum does not want to know.
        draw_key, agent_key: see `learn`.
    """

    key: jax.Array
    first: Any
    goals: Goals
    exploration: Exploration
    visit_key: jax.Array | None
    draw_key: jax.Array
    agent_key: jax.Array


def cycle(setup: Setup, state: TrainingState, hyper: Hyperparameters) -> TrainingState:
    """Choose goals, roll out, store, and update the networks: a cycle in one go, cut or not."""
    planned = plan(setup, state, hyper)
    rollout = carry_out(setup, state, hyper, planned, roll_out)
    state = store(setup, state, hyper, rollout).replace(key=planned.key)
    keys = planned.draw_key, planned.agent_key
    if not setup.is_cut:
        return learn(setup, state, hyper, *keys)
    return jax.lax.fori_loop(
        0,
        parts_of_updates(setup, hyper),
        lambda index, state: learn_part(setup, state, hyper, *keys, index),
        state,
    )


def plan(setup: Setup, state: TrainingState, hyper: Hyperparameters) -> Plan:
    """Choose where the episodes of a cycle begin, their goals and their noise."""
    env, settings = setup.env, setup.settings
    keys = jax.random.split(state.key, 8)
    key, goal_key, reset_key, noise_key, draw_key, agent_key, visit_key, act_key = keys
    first = reset(env, reset_key, settings.environments)
    curriculum: Curriculum = hyper.curriculum
    goals = curriculum.sample(
        state.curriculum, goal_key, drawn_goals(env, first), view_of(setup, state, hyper, first)
    )
    if goals.start is not None:
        first = jax.vmap(env.restart)(goals.start)  # pyright: ignore[reportAttributeAccessIssue]
    shape = (env.episode_length, settings.environments, env.action_size)
    uniform = None
    if hyper.relabelling.needs_stages:
        noise_key, stage_key = jax.random.split(noise_key)
        uniform = jax.random.uniform(stage_key, shape[:-1])
    exploration = draw_exploration(noise_key, shape, hyper).replace(uniform=uniform)
    if hyper.agent.explores:
        exploration = exploration.replace(key=jax.random.split(act_key, env.episode_length))
    visit_key = visit_key if curriculum.wants_visited else None
    return Plan(key, first, goals, exploration, visit_key, draw_key, agent_key)


def carry_out(
    setup: Setup,
    state: TrainingState,
    hyper: Hyperparameters,
    planned: Plan,
    roll: Callable[..., Result],
) -> Result:
    """What `roll_out` or `begin_rollout` makes of a plan and the agent as it is."""
    return roll(
        setup.env,
        training_policy(setup, state, hyper, planned.goals),
        planned.first,
        planned.goals,
        planned.exploration,
        visit_key=planned.visit_key,
    )


def store(
    setup: Setup, state: TrainingState, hyper: Hyperparameters, rollout: Rollout
) -> TrainingState:
    """Take in the episodes of a cycle: replay, curriculum, normaliser and statistics."""
    env, settings = setup.env, setup.settings
    return state.replace(
        replay=insert(state.replay, rollout.episodes, rollout.outcomes.valid),
        curriculum=hyper.curriculum.after_training(state.curriculum, rollout.outcomes),
        normaliser=observe(
            state.normaliser,
            rollout.episodes,
            rollout.outcomes.valid,
            rollout.drawn_goal,
            floor=settings.normaliser_floor,
            distance_threshold=env.distance_threshold,
        ),
        statistics=_count(state.statistics, rollout, env.distance_threshold),
        env_steps=state.env_steps + settings.environments * env.episode_length,
    )


def training_policy(
    setup: Setup, state: TrainingState, hyper: Hyperparameters, goals: Goals
) -> Policy:
    """The agent as it acts in training, with noise."""

    def policy(observation: jax.Array, goal: jax.Array, noise: Exploration | None) -> jax.Array:
        assert noise is not None
        subgoal = None
        if noise.uniform is not None:
            subgoal = hyper.relabelling.pursued(setup.stages, observation, goal, noise.uniform)
        inputs = network_inputs(
            setup, hyper, state.normaliser, observation, goal, goals.mask, goals.threshold, subgoal
        )
        action = hyper.agent.act(state.agent, inputs, noise.key)
        return explore(noise, action, perturb=not hyper.agent.explores)

    return policy


def view_of(setup: Setup, state: TrainingState, hyper: Hyperparameters, first: object) -> View:
    """What the curriculum may look at."""
    agent = hyper.agent

    def value(observation: jax.Array, goal: jax.Array) -> jax.Array:
        mask, threshold = (
            jnp.ones_like(goal),
            jnp.full(goal.shape[:-1], setup.env.distance_threshold),
        )
        inputs = network_inputs(setup, hyper, state.normaliser, observation, goal, mask, threshold)
        return agent.value(state.agent, inputs, agent.act(state.agent, inputs))

    def draw(key: jax.Array, count: int) -> jax.Array:
        # Only the goals are used, so that XLA leaves out physics that they do not depend on.
        return reset(setup.env, key, count).obs["desired_goal"]

    return View(
        first=first,
        achieved=state.replay.episodes.achieved_goal,
        filled=size(state.replay),
        value=value,
        draw=draw,
        steps=steps_taken(state.replay.episodes),
    )


def _count(statistics: EpochStatistics, rollout: Rollout, threshold: float) -> EpochStatistics:
    outcomes = rollout.outcomes
    valid = outcomes.valid
    moved = moved_goal(rollout.episodes.achieved_goal, threshold)
    statistics = statistics.replace(
        episodes=statistics.episodes + count_true(valid),
        moved_episodes=statistics.moved_episodes + count_true(valid & moved),
        physics_warnings=statistics.physics_warnings + count_true(rollout.broken),
    )
    if not statistics.mask_episodes.size:
        return statistics
    drawn = mask_indices(outcomes.goals.mask)
    return statistics.replace(
        mask_episodes=statistics.mask_episodes.at[drawn].add(valid.astype(jnp.float32)),
        mask_successes=statistics.mask_successes.at[drawn].add(
            (valid & outcomes.success).astype(jnp.float32)
        ),
    )
