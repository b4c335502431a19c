"""Masks drawn uniformly from all 2^n: what CGM is worth beyond masking at all.

python -m cgm_jax.train --curriculum uniform
"""

import jax

from cgm_jax.config.fields import settings
from cgm_jax.curricula.protocol import Curriculum, Goals, View, with_mask


@settings
class Uniform(Curriculum[tuple[()]]):
    """Each dimension is kept with probability 1/2, independently."""

    def sample(self, state: tuple[()], key: jax.Array, drawn: Goals, view: View) -> Goals:
        """The environment's goals under uniform masks."""
        del state, view
        kept = jax.random.bernoulli(key, shape=drawn.mask.shape)
        return with_mask(drawn, kept.astype(drawn.mask.dtype))
