"""Goal-conditioned deep deterministic policy gradient (Lillicrap et al. 2016).

The actor may be updated less often than the critic (Fujimoto et al. 2018).
"""

from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import optax
from flax import struct

from cgm_jax.agents.networks import Actor, Critic
from cgm_jax.agents.normaliser import Normaliser, network_input
from cgm_jax.config.settings import Hyperparameters
from cgm_jax.replay.relabelling import Transitions

Parameters = Any


class Agent(struct.PyTreeNode):
    """Networks, targets and optimiser states of one run; `updates` counts the updates."""

    actor: Parameters
    critic: Parameters
    target_actor: Parameters
    target_critic: Parameters
    actor_optimiser: optax.OptState
    critic_optimiser: optax.OptState
    updates: jax.Array


class Minibatch(struct.PyTreeNode):
    """Transitions with goals and observations as the networks take them."""

    inputs: jax.Array
    action: jax.Array
    reward: jax.Array
    next_inputs: jax.Array


def prepare(normaliser: Normaliser, transitions: Transitions) -> Minibatch:
    """Normalise transitions of any leading shape."""
    return Minibatch(
        inputs=network_input(normaliser, transitions.observation, transitions.goal),
        action=transitions.action,
        reward=transitions.reward,
        next_inputs=network_input(normaliser, transitions.next_observation, transitions.next_goal),
    )


@dataclass(frozen=True)
class DDPG:
    """The algorithm: static structure, with pure functions over an `Agent`.

    Attributes:
        input_size: size of normalised observation and goal together.
        action_size: number of action dimensions.
        hidden_layers: widths of both networks.
        target_update_every: updates between moves of the target networks.
        actor_update_every: updates of the critic for each of the actor.
    """

    input_size: int
    action_size: int
    hidden_layers: tuple[int, ...]
    target_update_every: int
    actor_update_every: int = 1

    @property
    def _actor(self) -> Actor:
        return Actor(self.hidden_layers, self.action_size)

    @property
    def _critic(self) -> Critic:
        return Critic(self.hidden_layers)

    @property
    def _adam(self) -> optax.GradientTransformation:
        # Without its step size, which is traced and differs between runs.
        return optax.scale_by_adam()

    def initial_agent(self, key: jax.Array) -> Agent:
        """Fresh networks, with targets equal to them."""
        actor_key, critic_key = jax.random.split(key)
        inputs, action = jnp.zeros(self.input_size), jnp.zeros(self.action_size)
        actor = self._actor.init(actor_key, inputs)
        critic = self._critic.init(critic_key, inputs, action)
        return Agent(
            actor=actor,
            critic=critic,
            target_actor=actor,
            target_critic=critic,
            actor_optimiser=self._adam.init(actor),
            critic_optimiser=self._adam.init(critic),
            updates=jnp.zeros((), jnp.int32),
        )

    def act(self, actor: Parameters, inputs: jax.Array) -> jax.Array:
        """The actor's action [..., action_size] for normalised inputs [..., input_size]."""
        return self._actor.apply(actor, inputs)  # pyright: ignore[reportReturnType]

    def value(self, critic: Parameters, inputs: jax.Array, action: jax.Array) -> jax.Array:
        """The critic's estimate [...] of the return of `action` in `inputs`."""
        return self._critic.apply(critic, inputs, action)  # pyright: ignore[reportReturnType]

    def critic_loss(
        self, critic: Parameters, agent: Agent, batch: Minibatch, hyper: Hyperparameters
    ) -> tuple[jax.Array, dict[str, jax.Array]]:
        """Mean squared error to the bootstrapped target, clipped to what returns can be.

        Rewards are -1 or 0 and no state is terminal, so that returns lie in
        [-1 / (1 - gamma), 0].
        """
        next_action = self.act(agent.target_actor, batch.next_inputs)
        next_value = self.value(agent.target_critic, batch.next_inputs, next_action)
        target = batch.reward + hyper.discount * next_value
        target = jnp.clip(target, -1.0 / (1.0 - hyper.discount), 0.0)
        value = self.value(critic, batch.inputs, batch.action)
        loss = jnp.mean(jnp.square(jax.lax.stop_gradient(target) - value))
        return loss, {"critic_loss": loss, "value": value.mean()}

    def actor_loss(
        self, actor: Parameters, agent: Agent, batch: Minibatch, hyper: Hyperparameters
    ) -> tuple[jax.Array, dict[str, jax.Array]]:
        """Minus the value of the actor's actions, plus a penalty on their mean square."""
        action = self.act(actor, batch.inputs)
        loss = -jnp.mean(self.value(agent.critic, batch.inputs, action))
        loss += hyper.action_penalty * jnp.mean(jnp.square(action))
        return loss, {"actor_loss": loss}

    def train(
        self, agent: Agent, batches: Minibatch, hyper: Hyperparameters
    ) -> tuple[Agent, dict[str, jax.Array]]:
        """One update per minibatch, every `actor_update_every`-th of them of both networks.

        Args:
            agent: before.
            batches: [updates, batch, ...]; `actor_update_every` divides the first axis.
            hyper: of the run.

        Returns:
            The agent, and what `update` returned for each update of both networks.
        """
        every = self.actor_update_every

        def train_round(agent: Agent, batches: Minibatch) -> tuple[Agent, dict[str, jax.Array]]:
            if every > 1:
                for_critic = jax.tree.map(lambda rows: rows[:-1], batches)
                agent, _ = jax.lax.scan(
                    lambda agent, batch: self.update_critic(agent, batch, hyper), agent, for_critic
                )
            return self.update(agent, jax.tree.map(lambda rows: rows[-1], batches), hyper)

        rounds = jax.tree.map(lambda rows: rows.reshape(-1, every, *rows.shape[1:]), batches)
        return jax.lax.scan(train_round, agent, rounds)

    def update(
        self, agent: Agent, batch: Minibatch, hyper: Hyperparameters
    ) -> tuple[Agent, dict[str, jax.Array]]:
        """One gradient step on both networks, both from their present weights; targets follow.

        Returns:
            The agent, and scalars to log: critic_loss, actor_loss, value.
        """
        # The actor first: its loss needs the critic, whose own loss needs only the target actor.
        agent, actor_info = self._improve_actor(agent, batch, hyper)
        agent, critic_info = self._improve_critic(agent, batch, hyper)
        return self._follow(agent, hyper), {**critic_info, **actor_info}

    def update_critic(
        self, agent: Agent, batch: Minibatch, hyper: Hyperparameters
    ) -> tuple[Agent, dict[str, jax.Array]]:
        """One gradient step on the critic alone; targets follow.

        Returns:
            The agent, and scalars to log: critic_loss, value.
        """
        agent, info = self._improve_critic(agent, batch, hyper)
        return self._follow(agent, hyper), info

    def _improve_actor(
        self, agent: Agent, batch: Minibatch, hyper: Hyperparameters
    ) -> tuple[Agent, dict[str, jax.Array]]:
        gradient, info = jax.grad(self.actor_loss, has_aux=True)(agent.actor, agent, batch, hyper)
        actor, optimiser = self._descend(
            agent.actor, gradient, agent.actor_optimiser, hyper.actor_learning_rate
        )
        return agent.replace(actor=actor, actor_optimiser=optimiser), info

    def _improve_critic(
        self, agent: Agent, batch: Minibatch, hyper: Hyperparameters
    ) -> tuple[Agent, dict[str, jax.Array]]:
        gradient, info = jax.grad(self.critic_loss, has_aux=True)(agent.critic, agent, batch, hyper)
        critic, optimiser = self._descend(
            agent.critic, gradient, agent.critic_optimiser, hyper.critic_learning_rate
        )
        return agent.replace(critic=critic, critic_optimiser=optimiser), info

    def _follow(self, agent: Agent, hyper: Hyperparameters) -> Agent:
        """Count an update, and move the targets if it is time."""
        updates = agent.updates + 1
        rate = jnp.where(updates % self.target_update_every == 0, hyper.target_rate, 0.0)
        return agent.replace(
            target_actor=optax.incremental_update(agent.actor, agent.target_actor, rate),
            target_critic=optax.incremental_update(agent.critic, agent.target_critic, rate),
            updates=updates,
        )

    def _descend(
        self,
        parameters: Parameters,
        gradient: Parameters,
        optimiser: optax.OptState,
        learning_rate: float | jax.Array,
    ) -> tuple[Parameters, optax.OptState]:
        direction, optimiser = self._adam.update(gradient, optimiser)
        step = jax.tree.map(lambda leaf: -learning_rate * leaf, direction)
        return optax.apply_updates(parameters, step), optimiser
