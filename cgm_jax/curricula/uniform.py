"""Masks drawn uniformly from all 2^n: what CGM is worth beyond masking at all.

python -m cgm_jax.train --curriculum uniform
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from cgm_jax.config.fields import settings
from cgm_jax.config.sizes import Sizes
from cgm_jax.curricula.parts.masks import MAX_TABULATED
from cgm_jax.curricula.protocol import Curriculum, Goals, View, with_mask


@settings
class Uniform(Curriculum[Float[Array, " masks"]]):
    """Each dimension is kept with probability 1/2, independently.

    Its state is what it reports: the probability of every mask [2^n], or [0] where n is above ten.
    """

    def init(self, sizes: Sizes) -> Float[Array, " masks"]:
        """The probability of every mask."""
        masks = 2**sizes.goal if sizes.goal <= MAX_TABULATED else 0
        return jnp.full(masks, 0.5**sizes.goal, jnp.float32)

    def sample(
        self, state: Float[Array, " masks"], key: jax.Array, drawn: Goals, view: View
    ) -> Goals:
        """The environment's goals under uniform masks."""
        del state, view
        kept = jax.random.bernoulli(key, shape=drawn.mask.shape)
        return with_mask(drawn, kept.astype(drawn.mask.dtype))

    def report(self, state: Float[Array, " masks"]) -> dict[str, jax.Array]:
        """Per mask, up to ten dimensions: its probability of being drawn [2^n]."""
        return {"mask_probability": state} if state.size else {}
