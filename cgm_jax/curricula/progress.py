"""Absolute learning progress: masks whose success rate changes, upwards or downwards.

    p(m) proportional to |change of the success rate of m| + eps

Matiisen et al. (2017, arXiv 1707.00183) let a teacher prefer the tasks on which the absolute slope
of the student's learning curve is steepest, so that what is being forgotten comes back as well. Its
scores are those of the training episodes, and so are these: a mask learns from episodes under that
mask alone, with exploration noise. The slope is that of CURIOUS (Colas et al. 2019, arXiv
1810.06284): over the latest w episodes, the success rate of the newer half less that of the older
half. CURIOUS measures it on noise-free episodes set apart for it, and mixes in a fixed share of
uniform draws; here eps is added to each change, so that masks are uniform where nothing changes.

Over w episodes a mask that succeeds half of the time by chance changes by about 1 / sqrt(w).

    python -m cgm_jax.train --curriculum progress --progress-window 200
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from cgm_jax.config.fields import settings, static, traced
from cgm_jax.config.sizes import Sizes
from cgm_jax.curricula.parts.masks import (
    check_tabulated,
    draw_from_table,
    mask_indices,
    proportional,
)
from cgm_jax.curricula.parts.windows import Windows, init_windows, progress, record_episodes
from cgm_jax.curricula.protocol import Curriculum, Goals, Outcomes, View


@settings
class Progress(Curriculum[Windows]):
    """Its state holds the outcomes of the latest training episodes of every mask."""

    progress_window: int = static(100, "training episodes behind a change of success, w", 2, 10**6)
    progress_floor: float = traced(0.02, "added to every change of success, eps", 1e-6, 1e6)

    def init(self, sizes: Sizes) -> Windows:
        """Nothing practised yet.

        Raises:
            SettingError: too many goal dimensions for a table of all masks.
        """
        check_tabulated("curriculum", "progress", sizes.goal)
        return init_windows(2**sizes.goal, self.progress_window)

    def sample(self, state: Windows, key: jax.Array, drawn: Goals, view: View) -> Goals:
        """The environment's goals, under masks whose success changes."""
        del view
        return draw_from_table(drawn, key, self.probabilities(state))

    def after_training(self, state: Windows, outcomes: Outcomes) -> Windows:
        """Take in whether masked goals were achieved."""
        practised = mask_indices(outcomes.goals.mask)
        return record_episodes(state, practised, outcomes.success, outcomes.valid)

    def report(self, state: Windows) -> dict[str, jax.Array]:
        """Per mask [2^n]: the change of its success rate, and its probability of being drawn."""
        return {"mask_progress": progress(state), "mask_probability": self.probabilities(state)}

    def probabilities(self, state: Windows) -> Float[Array, " masks"]:
        """Probability of drawing each mask, [2^n]."""
        return proportional(jnp.abs(progress(state)) + self.progress_floor)
