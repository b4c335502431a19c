"""HER's strategy "final" (Andrychowicz et al. 2017): a way to relabel of one's own, in one file.

Hindsight goals are where the episode came to in the end, and not a place on its way there.

    python -m cgm_jax.train --relabelling tests/examples/my_relabelling.py:Final --her-k 4
"""

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from cgm_jax.config.fields import settings
from cgm_jax.replay.future import Drawn, Future
from cgm_jax.replay.ring import Replay, steps_taken


@settings
class Final(Future):
    """Has the settings of `Future`, such as --her-k, and draws as that does, but for the goal."""

    def draw(
        self,
        replay: Replay,
        uniform: Float[Array, "4 count"],
        distance_threshold: float,
        anywhere: Bool[Array, " count"] | bool = False,
    ) -> Drawn:
        drawn = super().draw(replay, uniform, distance_threshold, anywhere)
        taken = steps_taken(replay.episodes)
        last = replay.episodes.action.shape[1] if taken is None else taken[drawn.episode]
        return drawn._replace(future=jnp.broadcast_to(last, drawn.step.shape))
