"""Imitation in hindsight (Ghosh et al. 2021): an agent of one's own, in one file.

Its loss is |pi(s, g) - a|^2, where HER has chosen a goal g that action a led to.

    python -m cgm_jax.train --agent tests/examples/my_agent.py:MyAgent --set width=128
"""

import jax
import jax.numpy as jnp
import optax
from flax import struct

from cgm_jax.agents.gradients import ADAM, descend
from cgm_jax.agents.networks import apply_actor, init_actor
from cgm_jax.agents.protocol import Agent, Info, Minibatch, Parameters
from cgm_jax.config.fields import settings, static, traced
from cgm_jax.config.sizes import Sizes


class MyState(struct.PyTreeNode):
    """One network and its optimiser's state; training names either if it diverges."""

    actor: Parameters
    optimiser: optax.OptState


@settings
class MyAgent(Agent[MyState]):
    """Its settings are options of the programs: --set NAME=VALUE."""

    critics = 0
    logged = ("actor_loss",)

    step_size: float = traced(1e-3, "Adam step size", 0)
    width: int = static(64, "units in each of two hidden layers", 1, 10**5)

    def init(self, key: jax.Array, sizes: Sizes) -> MyState:
        actor = init_actor(key, (self.width, self.width), sizes.inputs, sizes.action)
        return MyState(actor, ADAM.init(actor))

    def act(self, state: MyState, inputs: jax.Array, key: jax.Array | None = None) -> jax.Array:
        return apply_actor(state.actor, inputs)

    def train(self, state: MyState, batches: Minibatch, key: jax.Array) -> tuple[MyState, Info]:
        return jax.lax.scan(self._update, state, batches)

    def actor(self, state: MyState) -> Parameters:
        return state.actor

    def _update(self, state: MyState, batch: Minibatch) -> tuple[MyState, Info]:
        def loss(actor: Parameters) -> jax.Array:
            return jnp.mean(jnp.square(apply_actor(actor, batch.inputs) - batch.action))

        value, gradient = jax.value_and_grad(loss)(state.actor)
        actor, optimiser = descend(state.actor, gradient, state.optimiser, self.step_size)
        return MyState(actor, optimiser), {"actor_loss": value}
