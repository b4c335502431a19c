"""Sampling for learnability (Rutherford et al. 2024, arXiv 2408.15099): neither mastered nor never.

    p(m) proportional to c_m (1 - c_m),   c_m = product of the rates of kept sub-goals

The paper scores levels by p (1 - p), the variance of their success. It draws thousands at random,
runs the policy on each, and trains on the best scored. Here masks take the place of levels: all of
them are scored, none is run for it, and each is drawn in proportion to its score instead of evenly
from the best. In the authors' program half of the levels are drawn at random all the same; here
that share is `uniform_share`, 0 unless asked for, and without it a mask that keeps a sub-goal which
never succeeds is not drawn while any other scores. Sub-goal rates are CGM's: means over the last h
noise-free evaluation episodes. Before any, the full goal is taken to succeed half of the time,
where the score is greatest. Masks are uniform where no score is above 0, so where every sub-goal
always or never succeeds.

    python -m cgm_jax.train --curriculum learnability --success-history 20
"""

import jax
from jaxtyping import Array, Float

from cgm_jax.config.fields import settings, shared, traced
from cgm_jax.config.sizes import Sizes
from cgm_jax.curricula.cgm import CGM
from cgm_jax.curricula.parts.history import (
    SuccessHistory,
    init_history,
    record_successes,
    subgoal_rates,
)
from cgm_jax.curricula.parts.masks import (
    check_tabulated,
    draw_from_table,
    goal_masks,
    mask_success_rates,
    proportional,
)
from cgm_jax.curricula.protocol import Curriculum, Goals, Outcomes, View

MOST_LEARNABLE = 0.5
"""The success rate at which c (1 - c) is greatest."""


@settings
class Learnability(Curriculum[SuccessHistory]):
    """Its state holds the outcomes of evaluation episodes with the full goal, per sub-goal."""

    uniform_share: float = traced(0.0, "share of episodes whose masks are drawn uniformly", 0, 1)
    success_history: int = shared(CGM, "success_history")

    def init(self, sizes: Sizes) -> SuccessHistory:
        """Nothing known yet.

        Raises:
            SettingError: too many goal dimensions for a table of all masks.
        """
        check_tabulated("curriculum", "learnability", sizes.goal)
        return init_history(self.success_history, sizes.goal)

    def sample(self, state: SuccessHistory, key: jax.Array, drawn: Goals, view: View) -> Goals:
        """The environment's goals, under masks that sometimes succeed."""
        del view
        return draw_from_table(drawn, key, self.probabilities(self.rates(state)))

    def after_evaluation(
        self, state: SuccessHistory, outcomes: Outcomes, examined: Outcomes | None = None
    ) -> SuccessHistory:
        """Take in the sub-goals of noise-free episodes."""
        del examined
        return record_successes(state, outcomes.subgoal_success, outcomes.valid)

    def report(self, state: SuccessHistory) -> dict[str, jax.Array]:
        """Per mask [2^n]: its estimated success rate, and its probability of being drawn."""
        rates = self.rates(state)
        return {"mask_rate_estimated": rates, "mask_probability": self.probabilities(rates)}

    def rates(self, state: SuccessHistory) -> Float[Array, " masks"]:
        """Estimated success rate of every mask [2^n]."""
        masks = goal_masks(state.successes.shape[-1])
        return mask_success_rates(masks, subgoal_rates(state, MOST_LEARNABLE))

    def probabilities(self, rates: Float[Array, " masks"]) -> Float[Array, " masks"]:
        """Probability [2^n] of drawing each mask, given success rates [2^n]."""
        return (1.0 - self.uniform_share) * learnable(rates) + self.uniform_share / rates.size


def learnable(rates: Float[Array, " m"]) -> Float[Array, " m"]:
    """Probabilities proportional to c (1 - c), for success rates [m]; uniform where all are 0."""
    return proportional(rates * (1.0 - rates))
