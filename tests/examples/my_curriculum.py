"""Masks that keep more of a goal the better training goes: a curriculum of one's own, in one file.

    keep each dimension with probability q,    q <- q + gain * (success rate of the cycle - q)

Train with it, with two values of its own setting, by

    python -m cgm_jax.sweep --curriculum tests/examples/my_curriculum.py:Growing --set gain=0.5,0.7
"""

import jax
import jax.numpy as jnp

from cgm_jax.config.fields import settings, traced
from cgm_jax.config.sizes import Sizes
from cgm_jax.curricula.protocol import Curriculum, Goals, Outcomes, View, with_mask


@settings
class Growing(Curriculum[jax.Array]):
    """Its state is q, a scalar."""

    gain: float = traced(0.5, "how far q follows the success of a cycle", 0, 1)

    def init(self, sizes: Sizes) -> jax.Array:
        """Half of the dimensions."""
        del sizes
        return jnp.full((), 0.5, jnp.float32)

    def sample(self, state: jax.Array, key: jax.Array, drawn: Goals, view: View) -> Goals:
        """The environment's goals, of which each dimension is kept with probability q."""
        del view
        kept = jax.random.bernoulli(key, state, drawn.mask.shape)
        return with_mask(drawn, kept.astype(drawn.mask.dtype))

    def after_training(self, state: jax.Array, outcomes: Outcomes) -> jax.Array:
        """Follow the success of the episodes that count."""
        episodes = outcomes.valid.sum()
        rate = jnp.sum(outcomes.valid & outcomes.success) / jnp.maximum(episodes, 1)
        return jnp.where(episodes > 0, state + self.gain * (rate - state), state)

    def report(self, state: jax.Array) -> dict[str, jax.Array]:
        """q, as metrics.jsonl is to hold it."""
        return {"keep_probability": state}
