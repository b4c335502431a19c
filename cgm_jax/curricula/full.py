"""No curriculum: always the environment's own goal, whole.

python -m cgm_jax.train --curriculum full
"""

import jax

from cgm_jax.config.fields import settings
from cgm_jax.curricula.protocol import Curriculum, Goals, View


@settings
class Full(Curriculum[tuple[()]]):
    """What the paper compares with."""

    def sample(self, state: tuple[()], key: jax.Array, drawn: Goals, view: View) -> Goals:
        """What the environment drew."""
        del state, key, view
        return drawn
