"""The training loop: pure functions over a `TrainingState`, to be jitted and vmapped over runs.

    trainer = Trainer(env, Settings(...))
    state = trainer.initial_state(hyper)
    state, metrics = trainer.epoch(state, hyper)

One run is a sweep of one: `jax.vmap` the same functions over states and hyperparameters.
"""

import functools
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
from jax.custom_batching import sequential_vmap

from cgm_jax.agents.ddpg import DDPG, Agent, Minibatch, Parameters, prepare
from cgm_jax.agents.normaliser import initial_normaliser, network_input, observe
from cgm_jax.config.settings import Hyperparameters, SettingError, Settings, check_concrete
from cgm_jax.curricula.masking import (
    SuccessHistory,
    empty_history,
    goal_masks,
    joint_success_rates,
    mask_probabilities,
    mask_success_rates,
    record_successes,
    sample_masks,
    subgoal_rates,
    success_rates,
)
from cgm_jax.envs import GoalEnvironment
from cgm_jax.loop.divergence import freeze_if_failed
from cgm_jax.loop.exploration import Exploration, draw_exploration, explore
from cgm_jax.loop.rollout import Policy, roll_out
from cgm_jax.loop.state import EpochStatistics, TrainingState, empty_statistics
from cgm_jax.replay.relabelling import moved_goal, sample_transitions
from cgm_jax.replay.ring import empty_replay, insert

Metrics = dict[str, jax.Array]

GREATEST_GOAL_SIZE = 12
"""All 2^n masks are tabulated."""


@dataclass(frozen=True)
class Trainer:
    """Curriculum goal masking with DDPG and HER on one environment.

    Attributes:
        env: what to train on.
        settings: static settings; `settings.env` and `settings.engine` are not read here.

    Raises:
        SettingError: on first use, if the goal has more than 12 dimensions.
    """

    env: GoalEnvironment
    settings: Settings

    @functools.cached_property
    def _sizes(self) -> tuple[int, int]:
        """Sizes of the observation and of the goal."""
        state = jax.eval_shape(self.env.reset, jax.random.key(0))
        goal_size = state.obs["desired_goal"].shape[-1]
        if goal_size > GREATEST_GOAL_SIZE:
            raise SettingError(
                f"env: its goal has {goal_size} dimensions; masks serve up to {GREATEST_GOAL_SIZE}"
            )
        return state.obs["observation"].shape[-1], goal_size

    @functools.cached_property
    def ddpg(self) -> DDPG:
        """The learning algorithm."""
        return DDPG(
            input_size=sum(self._sizes),
            action_size=self.env.action_size,
            hidden_layers=self.settings.hidden_layers,
            target_update_every=self.settings.target_update_every,
            actor_update_every=self.settings.actor_update_every,
        )

    def initial_state(self, hyper: Hyperparameters) -> TrainingState:
        """The state of a run before any training; depends on `hyper.seed` alone.

        Raises:
            SettingError: a value of `hyper` is out of its range. Values that are traced cannot
                be checked here.
        """
        check_concrete(hyper)
        observation_size, goal_size = self._sizes
        key, agent_key = jax.random.split(jax.random.key(hyper.seed))
        length = self.env.episode_length
        return TrainingState(
            key=key,
            agent=self.ddpg.initial_agent(agent_key),
            normaliser=initial_normaliser(
                observation_size,
                goal_size,
                limit=self.settings.normaliser_limit,
                distance_threshold=self.env.distance_threshold,
            ),
            replay=empty_replay(
                max(self.settings.replay_transitions // length, self.settings.environments),
                length,
                observation_size,
                goal_size,
                self.env.action_size,
            ),
            history=empty_history(self.settings.success_history, goal_size),
            mask_history=empty_history(self.settings.success_history, 2**goal_size),
            statistics=empty_statistics(2**goal_size),
            env_steps=jnp.zeros((), jnp.int32),
            failure=jnp.zeros((), jnp.int32),
        )

    def epoch(self, state: TrainingState, hyper: Hyperparameters) -> tuple[TrainingState, Metrics]:
        """One epoch: `cycles_per_epoch` cycles, then an evaluation."""
        state = self.train_cycles(state, hyper, self.settings.cycles_per_epoch)
        return self.evaluate(state, hyper)

    def train_cycles(
        self, state: TrainingState, hyper: Hyperparameters, count: int | jax.Array
    ) -> TrainingState:
        """Any number of cycles: one scan whose length may be traced.

        So one program serves chunks of all lengths, and chunks give the bits of one whole.
        """
        return jax.lax.fori_loop(0, count, lambda _, state: self.cycle(state, hyper), state)

    def cycle(self, state: TrainingState, hyper: Hyperparameters) -> TrainingState:
        """Draw masks, roll out, store, and update the networks."""
        key, mask_key, reset_key, noise_key, update_key = jax.random.split(state.key, 5)
        drawn = sample_masks(mask_key, self.curriculum(state, hyper)[1], self.settings.environments)
        masks = goal_masks(self._sizes[1])[drawn]
        shape = (self.env.episode_length, self.settings.environments, self.env.action_size)
        rollout = roll_out(
            self.env,
            self._policy(state, state.agent.actor),
            reset_key,
            masks,
            draw_exploration(noise_key, shape, hyper),
        )
        moved = moved_goal(rollout.episodes.achieved_goal, self.env.distance_threshold)
        statistics = state.statistics
        statistics = statistics.replace(
            mask_episodes=statistics.mask_episodes.at[drawn].add(rollout.valid),
            mask_successes=statistics.mask_successes.at[drawn].add(
                rollout.valid & rollout.masked_success
            ),
            moved_episodes=statistics.moved_episodes + jnp.sum(rollout.valid & moved),
            physics_warnings=statistics.physics_warnings + jnp.sum(~rollout.valid),
        )
        state = state.replace(
            key=key,
            replay=insert(state.replay, rollout.episodes, rollout.valid),
            normaliser=observe(
                state.normaliser,
                rollout.episodes,
                rollout.valid,
                floor=self.settings.normaliser_floor,
                distance_threshold=self.env.distance_threshold,
            ),
            statistics=statistics,
            env_steps=state.env_steps + self.settings.environments * self.env.episode_length,
        )
        return self._update(state, hyper, update_key)

    def curriculum(
        self, state: TrainingState, hyper: Hyperparameters
    ) -> tuple[jax.Array, jax.Array]:
        """Per mask [2^n]: its estimated success rate, and its probability of being drawn.

        Once masks have been measured, their rate is the measured one. Without CGM the full goal
        has probability 1.
        """
        masks = goal_masks(self._sizes[1])
        estimates = jnp.where(
            hyper.factorised,
            mask_success_rates(masks, subgoal_rates(state.history, hyper.c_g)),
            joint_success_rates(masks, state.history, hyper.c_g),
        )
        rates = success_rates(state.mask_history, estimates)
        only_full_goal = jnp.zeros(len(masks)).at[-1].set(1.0)
        probabilities = mask_probabilities(rates, hyper.c_g, hyper.kappa)
        return rates, jnp.where(hyper.cgm, probabilities, only_full_goal)

    def evaluate(
        self, state: TrainingState, hyper: Hyperparameters
    ) -> tuple[TrainingState, Metrics]:
        """Close an epoch: noise-free episodes with the full goal, and the epoch's metrics.

        Feeds the sub-goal history, starts new epoch statistics, and returns, per run, what
        metrics.jsonl holds. Mask rates and probabilities are those that the epoch was trained
        with, so before this evaluation. Evaluation steps do not count as `env_steps`.
        """
        key, reset_key, masked_key = jax.random.split(state.key, 3)
        full = jnp.ones((self.settings.evaluation_episodes, self._sizes[1]))
        policy = self._policy(state, deterministic_actor(self.settings, state.agent))
        rollout = roll_out(self.env, policy, reset_key, full)
        valid = rollout.valid
        episodes = valid.sum()
        mask_history, broken = self._measure_masks(state, policy, masked_key)
        statistics = state.statistics
        rates, probabilities = self.curriculum(state, hyper)
        metrics = {
            "env_steps": state.env_steps,
            "updates": state.agent.updates,
            "success_rate": _ratio(jnp.sum(valid & rollout.success), episodes),
            "subgoal_success": _ratio(
                jnp.sum(valid[:, None] & rollout.subgoal_success, 0), episodes
            ),
            "mask_rate_estimated": rates,
            "mask_rate_training": _ratio(statistics.mask_successes, statistics.mask_episodes),
            "mask_probability": probabilities,
            "mask_share": _ratio(statistics.mask_episodes, statistics.mask_episodes.sum()),
            "moved_share": _ratio(statistics.moved_episodes, statistics.mask_episodes.sum()),
            "physics_warnings": statistics.physics_warnings + jnp.sum(~valid) + broken,
            "failure": state.failure,
            **{
                name: _ratio(total, statistics.updates) for name, total in statistics.losses.items()
            },
        }
        return state.replace(
            key=key,
            history=record_successes(state.history, rollout.subgoal_success, valid),
            mask_history=mask_history,
            statistics=empty_statistics(len(rates)),
        ), metrics

    def _measure_masks(
        self, state: TrainingState, policy: Policy, key: jax.Array
    ) -> tuple[SuccessHistory, jax.Array]:
        """Noise-free episodes with masked goals, equally many per mask.

        Returns:
            What is known of masks with them, and how many of them broken physics cost.
        """
        each = self.settings.masked_evaluation_episodes
        if not each:
            return state.mask_history, jnp.zeros(())
        masks = goal_masks(self._sizes[1])
        rollout = roll_out(self.env, policy, key, jnp.tile(masks, (each, 1)))
        successes, valid = (
            outcome.reshape(each, len(masks)) for outcome in (rollout.masked_success, rollout.valid)
        )
        history = record_successes(state.mask_history, successes, valid.all(axis=1))
        return history, jnp.sum(~valid)

    def _policy(self, state: TrainingState, actor: Parameters) -> Policy:
        """An actor with the state's normaliser, and with noise where there is some."""

        def policy(
            observation: jax.Array, goal: jax.Array, exploration: Exploration | None
        ) -> jax.Array:
            inputs = network_input(state.normaliser, observation, goal)
            action = self.ddpg.act(actor, inputs)
            return action if exploration is None else explore(exploration, action)

        return policy

    def minibatches(
        self, state: TrainingState, hyper: Hyperparameters, key: jax.Array
    ) -> Minibatch:
        """All minibatches of a cycle [updates, batch_size, ...].

        Replay and normaliser stay put during the updates, so that one draw serves them all.
        """
        updates, batch_size = self.settings.updates_per_cycle, self.settings.batch_size
        transitions = sample_transitions(
            key,
            state.replay,
            updates * batch_size,
            her_probability=jnp.where(hyper.her, hyper.her_k / (hyper.her_k + 1.0), 0.0),
            her_filter=jnp.asarray(hyper.her_filter),
            distance_threshold=self.env.distance_threshold,
        )
        return jax.tree.map(
            lambda rows: rows.reshape(updates, batch_size, *rows.shape[1:]),
            prepare(state.normaliser, transitions),
        )

    def _update(
        self, state: TrainingState, hyper: Hyperparameters, key: jax.Array
    ) -> TrainingState:
        agent, losses = _vmap_for_platform(self.ddpg.train)(
            state.agent, self.minibatches(state, hyper, key), hyper
        )
        failure, agent = freeze_if_failed(state.failure, state.agent, agent)
        return state.replace(
            agent=agent, failure=failure, statistics=_add_losses(state.statistics, losses)
        )


def _ratio(total: jax.Array, count: jax.Array) -> jax.Array:
    """A mean of `count` things; of none it is not a number, which is written as null.

    While JAX searches for NaN it must not find this one, so that it is infinite then.
    """
    none = -jnp.inf if jax.config.jax_debug_nans else jnp.nan  # pyright: ignore
    return jnp.where(count > 0, total / jnp.maximum(count, 1), none)


def deterministic_actor(settings: Settings, agent: Agent) -> Parameters:
    """The actor that is evaluated and exported.

    The target actor, an average over recent updates, swings less from one evaluation to the
    next than the actor itself.
    """
    return agent.target_actor if settings.evaluate_target else agent.actor


def _vmap_for_platform(function: Callable[..., Any]) -> Callable[..., Any]:
    """On a CPU, let vmap run a function for one run after the other.

    One matrix product keeps all cores busy, and XLA's batched one costs 15 % more than its
    parts. A GPU needs the batch.
    """
    return sequential_vmap(function) if jax.default_backend() == "cpu" else function


def _add_losses(statistics: EpochStatistics, losses: dict[str, jax.Array]) -> EpochStatistics:
    return statistics.replace(
        losses={name: total + losses[name].sum() for name, total in statistics.losses.items()},
        updates=statistics.updates + losses["actor_loss"].size,
    )
