"""Accuracy-based curriculum (Fournier et al. 2018, arXiv 1806.09614): how exactly to reach a goal.

    p(i) proportional to (|change of the success rate at threshold i| + eps)^beta

The distance threshold of a training episode is drawn from a ladder, evenly spaced from the
environment's own up to a multiple of it, by competence progress. The networks see the logarithm of
the threshold over the environment's own; replay keeps an episode's threshold, hindsight included;
evaluation is at the environment's own.

The paper draws its accuracy in proportion to the competence progress to the power of beta, and
measures competence by tests at every accuracy. Here competence is the success of the training
episodes at that threshold, and progress compares the halves of a window of them (see
parts/windows.py). eps, which the paper does not have, keeps every threshold in use and the draw
even where nothing changes.

    python -m cgm_jax.train --curriculum accuracy --threshold-widest 4
"""

from typing import ClassVar

import jax
import jax.numpy as jnp
from flax import struct
from jaxtyping import Array, Float

from cgm_jax.config.fields import settings, shared, static, traced
from cgm_jax.config.missing import missing
from cgm_jax.config.sizes import Sizes
from cgm_jax.curricula.parts.masks import proportional
from cgm_jax.curricula.parts.windows import (
    Windows,
    init_windows,
    progress,
    record_episodes,
    window_rates,
)
from cgm_jax.curricula.progress import Progress
from cgm_jax.curricula.protocol import Curriculum, Goals, Outcomes, View


class AccuracyState(struct.PyTreeNode):
    """What is known of every threshold.

    Attributes:
        thresholds: the environment's own first, [steps].
        windows: outcomes of the latest training episodes at each.
    """

    thresholds: jax.Array
    windows: Windows


@settings
class Accuracy(Curriculum[AccuracyState]):
    """Whole goals, at thresholds of its own choice."""

    shows_threshold: ClassVar[bool] = True

    threshold_steps: int = static(4, "distance thresholds to practise at", 1, 1000)
    threshold_widest: float = traced(
        2.5, "widest threshold, in multiples of the environment's", 1, 1e6
    )
    progress_window: int = shared(Progress, "progress_window")
    progress_floor: float = shared(Progress, "progress_floor")
    progress_exponent: float = traced(1.0, "preference for the greatest change, beta", 0, 100)

    def init(self, sizes: Sizes) -> AccuracyState:
        """Nothing practised yet."""
        multiples = jnp.linspace(1.0, self.threshold_widest, self.threshold_steps)
        return AccuracyState(
            thresholds=sizes.distance_threshold * multiples,
            windows=init_windows(self.threshold_steps, self.progress_window),
        )

    def sample(self, state: AccuracyState, key: jax.Array, drawn: Goals, view: View) -> Goals:
        """The environment's goals, at thresholds whose success changes."""
        del view
        logits = jnp.log(self.probabilities(state))
        drawn_step = jax.random.categorical(key, logits, shape=drawn.threshold.shape)
        return drawn.replace(threshold=state.thresholds[drawn_step])

    def after_training(self, state: AccuracyState, outcomes: Outcomes) -> AccuracyState:
        """Take in whether goals were achieved at their thresholds."""
        apart = jnp.abs(outcomes.goals.threshold[:, None] - state.thresholds)
        step = jnp.argmin(apart, axis=1).astype(jnp.int32)
        windows = record_episodes(state.windows, step, outcomes.success, outcomes.valid)
        return state.replace(windows=windows)

    def report(self, state: AccuracyState) -> dict[str, jax.Array]:
        """Per threshold [steps]: what it is, its success, how that changes, its probability."""
        return {
            "threshold": state.thresholds,
            "threshold_rate_training": window_rates(state.windows, missing()),
            "threshold_progress": progress(state.windows),
            "threshold_probability": self.probabilities(state),
        }

    def probabilities(self, state: AccuracyState) -> Float[Array, " steps"]:
        """Probability of drawing each threshold, [steps]."""
        change = jnp.abs(progress(state.windows)) + self.progress_floor
        return proportional((change / change.max()) ** self.progress_exponent)
