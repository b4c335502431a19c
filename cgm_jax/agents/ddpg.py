"""Goal-conditioned deep deterministic policy gradient (DDPG; Lillicrap et al. 2016).

    critic: (r + gamma Q'(s', pi'(s')) - Q(s, a))^2      actor: -Q(s, pi(s)) + penalty |pi(s)|^2

As in OpenAI baselines' HER, targets are clipped to what returns can be. Beyond it: targets may move
at every update, the actor may learn less often than the critics (Fujimoto et al. 2018), the target
actor may be the one that is evaluated, and there may be several critics: each learns from its own
target, and the actor climbs their mean.

    python -m cgm_jax.train --agent ddpg --hidden-layers 256 256 256
"""

import jax
import jax.numpy as jnp
import optax
from flax import struct
from jaxtyping import Array, Float

from cgm_jax.agents.gradients import (
    ADAM,
    check_rounds,
    clip_return,
    descend,
    follow,
    train_in_rounds,
)
from cgm_jax.agents.networks import (
    apply_actor,
    apply_critic,
    apply_critics,
    init_actor,
    init_networks,
)
from cgm_jax.agents.protocol import Agent, Info, Minibatch, Parameters
from cgm_jax.config.common import Common
from cgm_jax.config.fields import settings, shared, static, traced
from cgm_jax.config.sizes import Sizes


class DDPGState(struct.PyTreeNode):
    """Networks, targets and optimiser states; `critic` holds as many as there are critics."""

    actor: Parameters
    critic: tuple[Parameters, ...]
    target_actor: Parameters
    target_critic: tuple[Parameters, ...]
    actor_optimiser: optax.OptState
    critic_optimiser: optax.OptState
    updates: jax.Array


@settings
class DDPG(Agent[DDPGState]):
    """The paper's agent. Its settings, with the names of the options."""

    actor_learning_rate: float = traced(1e-3, "Adam step size of the actor", 0)
    critic_learning_rate: float = traced(1e-3, "Adam step size of the critics", 0)
    discount: float = shared(Common, "discount")
    target_rate: float = traced(0.05, "how far targets move towards the networks", 0, 1)
    action_penalty: float = traced(1.0, "weight of mean squared action in the actor loss", 0)
    hidden_layers: tuple[int, ...] = static((256, 256, 256), "widths of hidden layers", 1, 10**5)
    critics: int = static(1, "critics that learn side by side", 1, 100)
    target_update_every: int = static(40, "updates between moves of the targets", 1, 10**9)
    actor_update_every: int = static(1, "updates of the critics for each of the actor", 1, 10**6)
    evaluate_target: bool = static(False, "evaluate and export the target actor")

    def init(self, key: jax.Array, sizes: Sizes) -> DDPGState:
        """Fresh networks, with targets equal to them.

        Raises:
            SettingError: actor_update_every does not divide updates_per_cycle.
        """
        check_rounds(self.actor_update_every, sizes)
        actor, critic = init_networks(key, init_actor, self.critics, self.hidden_layers, sizes)
        return DDPGState(
            actor=actor,
            critic=critic,
            target_actor=actor,
            target_critic=critic,
            actor_optimiser=ADAM.init(actor),
            critic_optimiser=ADAM.init(critic),
            updates=jnp.zeros((), jnp.int32),
        )

    def act(
        self, state: DDPGState, inputs: Float[Array, "*batch inputs"], key: jax.Array | None = None
    ) -> Float[Array, "*batch action"]:
        """The actor's action, without noise."""
        del key
        return apply_actor(state.actor, inputs)

    def value(
        self,
        state: DDPGState,
        inputs: Float[Array, "*batch inputs"],
        action: Float[Array, "*batch action"],
    ) -> Float[Array, " critics *batch"]:
        """What each critic expects, [critics, ...]."""
        return apply_critics(state.critic, inputs, action)

    def actor(self, state: DDPGState) -> Parameters:
        """The actor, or its target.

        The target actor, an average over recent updates, swings less from one evaluation to the
        next than the actor itself.
        """
        return state.target_actor if self.evaluate_target else state.actor

    def with_actor(self, state: DDPGState, actor: Parameters) -> DDPGState:
        """The state with this actor, which its target is as well."""
        return state.replace(actor=actor, target_actor=actor)

    def critic_loss(
        self, critic: tuple[Parameters, ...], state: DDPGState, batch: Minibatch
    ) -> tuple[jax.Array, Info]:
        """Mean squared error of each critic to its own bootstrapped target, summed over critics."""
        next_action = apply_actor(state.target_actor, batch.next_inputs)
        losses, means = [], []
        for one, its_target in zip(critic, state.target_critic, strict=True):
            next_value = apply_critic(its_target, batch.next_inputs, next_action)
            target = batch.reward + batch.discounts(self.discount) * next_value
            target = clip_return(target, self.discount, batch.reward_range)
            value = apply_critic(one, batch.inputs, batch.action)
            losses.append(jnp.mean(jnp.square(jax.lax.stop_gradient(target) - value)))
            means.append(value.mean())
        loss, value = jnp.asarray(sum(losses)), jnp.asarray(sum(means))
        return loss, {"critic_loss": loss / self.critics, "value": value / self.critics}

    def actor_loss(
        self, actor: Parameters, state: DDPGState, batch: Minibatch
    ) -> tuple[jax.Array, Info]:
        """Minus the value of the actor's actions, plus a penalty on their mean square."""
        action = apply_actor(actor, batch.inputs)
        means = [jnp.mean(apply_critic(one, batch.inputs, action)) for one in state.critic]
        loss = -sum(means) / self.critics
        loss += self.action_penalty * jnp.mean(jnp.square(action))
        return loss, {"actor_loss": loss}

    def train(self, state: DDPGState, batches: Minibatch, key: jax.Array) -> tuple[DDPGState, Info]:
        """One update per minibatch, every `actor_update_every`-th of them of all networks.

        Returns:
            The state, and what `update` returned for each update of all networks.
        """
        del key
        every = self.actor_update_every
        return train_in_rounds(state, batches, every, self.update_critic, self.update)

    def update(self, state: DDPGState, batch: Minibatch) -> tuple[DDPGState, Info]:
        """One gradient step on all networks, each from the present weights; targets follow.

        Returns:
            The state, and scalars to log: critic_loss, actor_loss, value.
        """
        # The actor first: its loss needs the critics, whose own loss needs only the target actor.
        gradient, actor_info = jax.grad(self.actor_loss, has_aux=True)(state.actor, state, batch)
        actor, optimiser = descend(
            state.actor, gradient, state.actor_optimiser, self.actor_learning_rate
        )
        state = state.replace(actor=actor, actor_optimiser=optimiser)
        state, critic_info = self.update_critic(state, batch)
        return state, {**critic_info, **actor_info}

    def update_critic(self, state: DDPGState, batch: Minibatch) -> tuple[DDPGState, Info]:
        """One gradient step on the critics alone; targets follow.

        Returns:
            The state, and scalars to log: critic_loss, value.
        """
        gradient, info = jax.grad(self.critic_loss, has_aux=True)(state.critic, state, batch)
        critic, optimiser = descend(
            state.critic, gradient, state.critic_optimiser, self.critic_learning_rate
        )
        state = state.replace(critic=critic, critic_optimiser=optimiser, updates=state.updates + 1)
        target_actor, target_critic = follow(
            (state.actor, state.critic),
            (state.target_actor, state.target_critic),
            state.updates,
            self.target_update_every,
            self.target_rate,
        )
        return state.replace(target_actor=target_actor, target_critic=target_critic), info
