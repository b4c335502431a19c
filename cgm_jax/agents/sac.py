"""Soft actor-critic with an automatic temperature (SAC; Haarnoja et al. 2018, arXiv 1812.05905).

    critics:     (r + gamma (min_i Q_i'(s', a') - alpha log pi(a'|s')) - Q_j(s, a))^2,  a' ~ pi(s')
    actor:       alpha log pi(a|s) - min_i Q_i(s, a),                                    a ~ pi(s)
    temperature: -log(alpha) (log pi(a|s) + H)

Actions are tanh(mean + std N(0, 1)); their log-probability is in closed form where others add 1e-6
inside a logarithm. The temperature's loss is Stable-Baselines3's, with log(alpha) for the paper's
alpha. Steps are taken in the order critics, actor, temperature, each with the alpha from before, to
the same effect as Stable-Baselines3's, whose temperature goes first. It explores by sampling;
evaluated and exported is tanh(mean).

Beyond the paper, targets are clipped. With rewards of -1 or 0 the optimal soft value lies between
that of uniform actions, where no goal is ever achieved, and that of a goal achieved for ever with
the entropy of uniform actions, n log 2: the interval of plain returns, shifted by what that entropy
is worth. Where episodes end, any share of it may be missing, so that only the upper end is shifted.
The temperature starts at 0.1: the paper's 1 would have values of entropy outweigh rewards for the
first thousand updates.

Presets come before the defaults below, also where their values were chosen for DDPG: with `cpu`,
`gpu` and, except on reach, `quick`, actor and temperature move at every second update. At every one
they do with

    python -m cgm_jax.train --agent sac --actor-update-every 1
"""

import math

import jax
import jax.numpy as jnp
import optax
from flax import struct
from jaxtyping import Array, Float

from cgm_jax.agents.ddpg import DDPG
from cgm_jax.agents.gradients import (
    ADAM,
    NoisyMinibatch,
    check_rounds,
    clip_return,
    critic_errors,
    descend,
    follow,
    return_limits,
    train_in_rounds,
)
from cgm_jax.agents.networks import (
    apply_critics,
    apply_gaussian_actor,
    init_gaussian_actor,
    init_networks,
    mean_actor,
    with_mean,
)
from cgm_jax.agents.protocol import Agent, Info, Minibatch, Parameters
from cgm_jax.config.fields import settings, shared, traced
from cgm_jax.config.sizes import Sizes


class SACState(struct.PyTreeNode):
    """Networks, targets, temperature and optimiser states."""

    actor: Parameters
    critic: tuple[Parameters, ...]
    target_critic: tuple[Parameters, ...]
    log_temperature: jax.Array
    actor_optimiser: optax.OptState
    critic_optimiser: optax.OptState
    temperature_optimiser: optax.OptState
    updates: jax.Array


@settings
class SAC(Agent[SACState]):
    """Its settings, with the names of the options."""

    explores = True
    logged = ("critic_loss", "actor_loss", "value", "temperature", "entropy")

    actor_learning_rate: float = shared(DDPG, "actor_learning_rate")
    critic_learning_rate: float = shared(DDPG, "critic_learning_rate")
    temperature_learning_rate: float = traced(1e-3, "Adam step size of log(temperature)", 0)
    discount: float = shared(DDPG, "discount")
    target_rate: float = shared(DDPG, "target_rate", 0.005)
    initial_temperature: float = traced(0.1, "temperature alpha before any training", 1e-9, 1e6)
    target_entropy: float = traced(
        -1.0, "entropy aimed at, per dimension of actions; none has more than log 2", -1e3, 1e3
    )
    hidden_layers: tuple[int, ...] = shared(DDPG, "hidden_layers")
    critics: int = shared(DDPG, "critics", 2)
    target_update_every: int = shared(DDPG, "target_update_every", 1)
    actor_update_every: int = shared(DDPG, "actor_update_every")

    def init(self, key: jax.Array, sizes: Sizes) -> SACState:
        """Fresh networks, with targets equal to them.

        Raises:
            SettingError: actor_update_every does not divide updates_per_cycle.
        """
        check_rounds(self.actor_update_every, sizes)
        actor, critic = init_networks(
            key, init_gaussian_actor, self.critics, self.hidden_layers, sizes
        )
        log_temperature = jnp.log(jnp.asarray(self.initial_temperature, jnp.float32))
        return SACState(
            actor=actor,
            critic=critic,
            target_critic=critic,
            log_temperature=log_temperature,
            actor_optimiser=ADAM.init(actor),
            critic_optimiser=ADAM.init(critic),
            temperature_optimiser=ADAM.init(log_temperature),
            updates=jnp.zeros((), jnp.int32),
        )

    def act(
        self, state: SACState, inputs: Float[Array, "*batch inputs"], key: jax.Array | None = None
    ) -> Float[Array, "*batch action"]:
        """Sampled actions with a key, tanh(mean) without."""
        mean, log_std = apply_gaussian_actor(state.actor, inputs)
        if key is not None:
            mean += jnp.exp(log_std) * jax.random.normal(key, mean.shape)
        return jnp.tanh(mean)

    def value(
        self,
        state: SACState,
        inputs: Float[Array, "*batch inputs"],
        action: Float[Array, "*batch action"],
    ) -> Float[Array, " critics *batch"]:
        """What each critic expects, entropy included, [critics, ...]."""
        return apply_critics(state.critic, inputs, action)

    def actor(self, state: SACState) -> Parameters:
        """The actor without its noise, tanh(mean)."""
        return mean_actor(state.actor)

    def with_actor(self, state: SACState, actor: Parameters) -> SACState:
        """The state with an actor of these means; its standard deviations stay."""
        return state.replace(actor=with_mean(state.actor, actor))

    def critic_loss(
        self, critic: tuple[Parameters, ...], state: SACState, batch: NoisyMinibatch
    ) -> tuple[jax.Array, Info]:
        """Mean squared error of each critic to the target that they share, summed over critics."""
        next_action, log_probability = sample(state.actor, batch.next_inputs, batch.next_noise)
        next_value = apply_critics(state.target_critic, batch.next_inputs, next_action).min(axis=0)
        temperature = jnp.exp(state.log_temperature)
        discount = batch.discounts(self.discount)
        target = batch.reward + discount * (next_value - temperature * log_probability)
        # The future entropy of uniform actions in [-1, 1], above 0.
        shift = temperature * batch.action.shape[-1] * math.log(2.0)
        shift *= discount / (1.0 - self.discount)
        if batch.continues is None:
            target = clip_return(target - shift, self.discount, batch.reward_range) + shift
        else:  # the episode may end before any of it is collected
            low, high = return_limits(self.discount, batch.reward_range)
            target = jnp.clip(target, low, high + shift)
        value = apply_critics(critic, batch.inputs, batch.action)
        return critic_errors(value, target)

    def actor_loss(
        self, actor: Parameters, state: SACState, batch: NoisyMinibatch
    ) -> tuple[jax.Array, Info]:
        """Minus the soft value of the actor's actions."""
        assert batch.noise is not None
        action, log_probability = sample(actor, batch.inputs, batch.noise)
        temperature = jnp.exp(state.log_temperature)
        value = apply_critics(state.critic, batch.inputs, action).min(axis=0)
        loss = jnp.mean(temperature * log_probability - value)
        entropy = -log_probability.mean()
        return loss, {"actor_loss": loss, "temperature": temperature, "entropy": entropy}

    def temperature_loss(
        self, log_temperature: jax.Array, entropy: jax.Array, actions: int
    ) -> jax.Array:
        """Falls with the temperature where the actor has more entropy than aimed at."""
        return log_temperature * (entropy - self.target_entropy * actions)

    def train(self, state: SACState, batches: Minibatch, key: jax.Array) -> tuple[SACState, Info]:
        """One update per minibatch, every `actor_update_every`-th of them of all networks.

        Returns:
            The state, and what `update` returned for each update of all networks.
        """
        noise, next_noise = jax.random.normal(key, (2, *batches.action.shape))
        noisy = NoisyMinibatch(**vars(batches), noise=noise, next_noise=next_noise)
        every = self.actor_update_every
        return train_in_rounds(state, noisy, every, self.update_critic, self.update)

    def update(self, state: SACState, batch: NoisyMinibatch) -> tuple[SACState, Info]:
        """One gradient step on the critics, then on the actor, then on the temperature.

        Returns:
            The state, and scalars to log: those of `logged`.
        """
        state, critic_info = self.update_critic(state, batch)
        gradient, info = jax.grad(self.actor_loss, has_aux=True)(state.actor, state, batch)
        actor, actor_optimiser = descend(
            state.actor, gradient, state.actor_optimiser, self.actor_learning_rate
        )
        slope = jax.grad(self.temperature_loss)(
            state.log_temperature, info["entropy"], batch.action.shape[-1]
        )
        log_temperature, temperature_optimiser = descend(
            state.log_temperature,
            slope,
            state.temperature_optimiser,
            self.temperature_learning_rate,
        )
        state = state.replace(
            actor=actor,
            actor_optimiser=actor_optimiser,
            log_temperature=log_temperature,
            temperature_optimiser=temperature_optimiser,
        )
        return state, {**critic_info, **info}

    def idle(self) -> frozenset[str]:
        """With a temperature that stays as it is, the entropy that it would aim at."""
        learns = self.temperature_learning_rate
        return frozenset() if learns else frozenset({"target_entropy"})

    def update_critic(self, state: SACState, batch: NoisyMinibatch) -> tuple[SACState, Info]:
        """One gradient step on the critics alone; targets follow.

        Returns:
            The state, and scalars to log: critic_loss, value.
        """
        gradient, info = jax.grad(self.critic_loss, has_aux=True)(state.critic, state, batch)
        critic, optimiser = descend(
            state.critic, gradient, state.critic_optimiser, self.critic_learning_rate
        )
        updates = state.updates + 1
        target = follow(
            critic, state.target_critic, updates, self.target_update_every, self.target_rate
        )
        return state.replace(
            critic=critic, critic_optimiser=optimiser, target_critic=target, updates=updates
        ), info


def sample(
    actor: Parameters, inputs: Float[Array, "*batch inputs"], noise: Float[Array, "*batch action"]
) -> tuple[Float[Array, "*batch action"], Float[Array, "*batch"]]:
    """Actions [..., action] and the logarithms [...] of their probability densities.

    Haarnoja et al. (2018), appendix C: log N(u; mean, std) - sum_i log(1 - tanh(u_i)^2), of which
    the last is 2 (log 2 - u - softplus(-2 u)).

    Args:
        actor: parameters of a Gaussian actor.
        inputs: [..., inputs].
        noise: standard normal, [..., action].
    """
    mean, log_std = apply_gaussian_actor(actor, inputs)
    before = mean + jnp.exp(log_std) * noise
    density = -0.5 * (jnp.square(noise) + math.log(2.0 * math.pi)) - log_std
    squeeze = 2.0 * (math.log(2.0) - before - jax.nn.softplus(-2.0 * before))
    return jnp.tanh(before), (density - squeeze).sum(axis=-1)
