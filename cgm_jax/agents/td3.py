"""Twin delayed deep deterministic policy gradient (TD3; Fujimoto, van Hoof and Meger 2018).

    critics: (r + gamma min_i Q_i'(s', clip(pi'(s') + e)) - Q_j(s, a))^2,  e ~ clip(N(0, sigma), c)
    actor:   -Q_1(s, pi(s)) + penalty |pi(s)|^2

DDPG whose critics share one target: the least of theirs, which keeps values from growing too large,
at an action with noise on it, which keeps the actor from climbing narrow peaks. Actor and targets
move at every second update (the paper's d). Beyond the paper, as in DDPG here: targets are clipped
to what returns can be, actions have a penalty, and an update of both takes each gradient from the
weights before it, where the paper's actor follows critics that have just moved.

Presets come before the defaults below, also where their values were chosen for DDPG: with `cpu` and
`quick` targets move at every update. Delayed as in the paper it is with

    python -m cgm_jax.train --agent td3 --actor-update-every 2 --target-update-every 2
"""

import jax
import jax.numpy as jnp

from cgm_jax.agents.ddpg import DDPG, DDPGState
from cgm_jax.agents.gradients import NoisyMinibatch, clip_return, critic_errors
from cgm_jax.agents.networks import apply_actor, apply_critic, apply_critics
from cgm_jax.agents.protocol import Info, Minibatch, Parameters
from cgm_jax.config.fields import settings, shared, traced


@settings
class TD3(DDPG):
    """DDPG with the paper's three changes. Its settings, with the names of the options."""

    target_rate: float = shared(DDPG, "target_rate", 0.005)
    target_noise: float = traced(0.2, "standard deviation of noise on target actions", 0)
    target_noise_clip: float = traced(0.5, "noise on target actions is clipped to +-this", 0)
    critics: int = shared(DDPG, "critics", 2)
    target_update_every: int = shared(DDPG, "target_update_every", 2)
    actor_update_every: int = shared(DDPG, "actor_update_every", 2)

    def critic_loss(
        self, critic: tuple[Parameters, ...], state: DDPGState, batch: Minibatch
    ) -> tuple[jax.Array, Info]:
        """Mean squared error of each critic to the target that they share, summed over critics."""
        assert isinstance(batch, NoisyMinibatch)
        limit = self.target_noise_clip
        noise = jnp.clip(self.target_noise * batch.next_noise, -limit, limit)
        next_action = apply_actor(state.target_actor, batch.next_inputs) + noise
        next_action = jnp.clip(next_action, -1.0, 1.0)
        next_value = apply_critics(state.target_critic, batch.next_inputs, next_action).min(axis=0)
        target = batch.reward + batch.discounts(self.discount) * next_value
        target = clip_return(target, self.discount, batch.reward_range)
        value = apply_critics(critic, batch.inputs, batch.action)
        return critic_errors(value, target)

    def actor_loss(
        self, actor: Parameters, state: DDPGState, batch: Minibatch
    ) -> tuple[jax.Array, Info]:
        """Minus the first critic's value of the actor's actions, plus their penalty."""
        action = apply_actor(actor, batch.inputs)
        loss = -apply_critic(state.critic[0], batch.inputs, action).mean()
        loss += self.action_penalty * jnp.mean(jnp.square(action))
        return loss, {"actor_loss": loss}

    def train(self, state: DDPGState, batches: Minibatch, key: jax.Array) -> tuple[DDPGState, Info]:
        """DDPG's updates, with noise for all of them drawn at once."""
        next_noise = jax.random.normal(key, batches.action.shape)
        return super().train(state, NoisyMinibatch(**vars(batches), next_noise=next_noise), key)

    def idle(self) -> frozenset[str]:
        """Without noise on target actions, its limit; and where that is 0, how much there is."""
        if not self.target_noise:
            return frozenset({"target_noise_clip"})
        return frozenset() if self.target_noise_clip else frozenset({"target_noise"})
