"""Curriculum goal masking (CGM; Eppe, Magg and Wermter 2019): masks near a chosen success rate.

    p(m) proportional to (1 - |c_m - c_g|)^kappa,   c_m = product of the rates of kept sub-goals

The paper prints |c_m - c_g|^kappa, which would prefer masks far from c_g; its text and the authors'
program say near. Sub-goal rates are means over the last h noise-free evaluation episodes with the
full goal; before any, c_g^(1/n). Two other estimates judge the product: joint rates (`factorised`
off), which are not in the paper, and noise-free episodes of each mask
(`masked_evaluation_episodes`), which the paper names first and leaves for their number.

A share of the episodes can get the full goal in any case (`full_share`, p_full in the authors'
program).

Goals of more than ten dimensions have too many masks for a table, which both of these need: masks
are then drawn dimension by dimension, see parts/lookahead.py. In many dimensions nearly all masks
are far from c_g, and the weights of single masks do not make up for that. With `mask_levels`, a
method of this project, a difficulty is drawn first, and then a uniform mask of it, see
parts/levels.py.

    python -m cgm_jax.train --curriculum cgm --c-g 0.1 --kappa 32
"""

import jax
import jax.numpy as jnp
from flax import struct
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from cgm_jax.config.fields import SettingError, settings, static, traced
from cgm_jax.config.sizes import Sizes
from cgm_jax.curricula.parts.history import (
    SuccessHistory,
    init_history,
    record_successes,
    subgoal_rates,
    success_rates,
)
from cgm_jax.curricula.parts.levels import (
    MAX_GOAL_SIZE,
    REPORTED,
    draw_masks_by_difficulty,
    probabilities_by_difficulty,
    report_levels,
)
from cgm_jax.curricula.parts.lookahead import draw_masks
from cgm_jax.curricula.parts.masks import (
    MAX_TABULATED,
    check_tabulated,
    draw_from_table,
    goal_masks,
    mask_probabilities,
    mask_success_rates,
)
from cgm_jax.curricula.parts.windows import Windows, init_windows, record_episodes, window_rates
from cgm_jax.curricula.protocol import Curriculum, Goals, Outcomes, View, with_mask

REPORTED_DRAWS = 1024
"""Masks that a report on goals of many dimensions draws, to say what is practised."""


class CGMState(struct.PyTreeNode):
    """What CGM knows.

    Attributes:
        subgoals: outcomes of evaluation episodes with the full goal, per sub-goal.
        masks: of those with masked goals, per mask; None unless they are measured.
    """

    subgoals: SuccessHistory
    masks: Windows | None = None


@settings
class CGM(Curriculum[CGMState]):
    """The paper's curriculum. Its settings, with the names of the options."""

    c_g: float = traced(0.1, "success rate aimed at by the mask sampler", 0, 1)
    kappa: float = traced(32.0, "how strongly masks near c_g are preferred; 0: not at all", 0, 1e6)
    full_share: float = traced(0.0, "share of episodes that get the full goal in any case", 0, 1)
    factorised: bool = static(True, "estimate masks as if sub-goals succeeded independently")
    mask_levels: bool = static(False, "draw a difficulty first, then a mask of that difficulty")
    success_history: int = static(10, "evaluation episodes behind success rates, h", 1, 10**6)
    masked_evaluation_episodes: int = static(
        0, "noise-free episodes per mask and epoch, to measure it; 0: estimate it", 0, 10**6
    )

    def init(self, sizes: Sizes) -> CGMState:
        """Nothing known yet.

        Raises:
            SettingError: an estimate needs a table of all masks, and goals have too many
                dimensions for one; or too many to draw a difficulty first.
        """
        if not self.factorised:
            check_tabulated("factorised", "curriculum cgm without it", sizes.goal)
        if self.mask_levels and sizes.goal > MAX_GOAL_SIZE:
            raise SettingError(
                f"mask_levels: goals of {sizes.goal} dimensions have more than {MAX_GOAL_SIZE}"
            )
        subgoals = init_history(self.success_history, sizes.goal)
        if not self.masked_evaluation_episodes:
            return CGMState(subgoals)
        check_tabulated(
            "masked_evaluation_episodes", "measuring masks in curriculum cgm", sizes.goal
        )
        return CGMState(subgoals, init_windows(2**sizes.goal, self.success_history))

    def sample(self, state: CGMState, key: jax.Array, drawn: Goals, view: View) -> Goals:
        """The environment's goals, under masks near the success rate aimed at."""
        del view
        count, goal_size = drawn.mask.shape
        if goal_size > MAX_TABULATED:
            return with_mask(drawn, self.draw(state, key, count)[0])
        return draw_from_table(drawn, key, self.probabilities(self.rates(state)))

    def after_evaluation(
        self, state: CGMState, outcomes: Outcomes, examined: Outcomes | None = None
    ) -> CGMState:
        """Take in noise-free episodes: sub-goals of the full goal, and masks that were measured."""
        subgoals = record_successes(state.subgoals, outcomes.subgoal_success, outcomes.valid)
        if examined is None or state.masks is None:
            return state.replace(subgoals=subgoals)
        masks = jnp.arange(state.masks.inserted.shape[0])
        shape = (self.masked_evaluation_episodes, -1)  # a round of all masks after another
        rounds = tuple(x.reshape(shape) for x in (examined.success, examined.valid))
        measured, _ = jax.lax.scan(
            lambda windows, one: (record_episodes(windows, masks, *one), None), state.masks, rounds
        )
        return CGMState(subgoals, measured)

    def examination(self, sizes: Sizes) -> Float[Array, "P n"] | None:
        """Equally many episodes per mask, where masks are to be measured."""
        if not self.masked_evaluation_episodes:
            return None
        return jnp.tile(goal_masks(sizes.goal), (self.masked_evaluation_episodes, 1))

    def report(self, state: CGMState) -> dict[str, jax.Array]:
        """What masks practise.

        Up to ten dimensions per mask [2^n]: its estimated success rate, and its probability of
        being drawn. Beyond, by estimated success rate (`level`) in steps of 0.05, from 1,024
        draws: the share of masks near it, and the dimensions that these keep, [21].
        """
        if state.subgoals.successes.shape[-1] <= MAX_TABULATED:
            rates = self.rates(state)
            return {"mask_rate_estimated": rates, "mask_probability": self.probabilities(rates)}
        levels = report_levels(*self.draw(state, jax.random.key(0), REPORTED_DRAWS))
        return {
            "level": jnp.linspace(0.0, 1.0, REPORTED),
            "level_probability": levels.probability,
            "level_kept_dimensions": levels.kept_dimensions,
        }

    def rates(self, state: CGMState) -> Float[Array, " masks"]:
        """Estimated success rate of every mask [2^n]; once masks are measured, the measured one."""
        masks = goal_masks(state.subgoals.successes.shape[-1])
        if self.factorised:
            estimates = mask_success_rates(masks, subgoal_rates(state.subgoals, self.c_g))
        else:
            estimates = joint_success_rates(masks, state.subgoals, self.c_g)
        return estimates if state.masks is None else window_rates(state.masks, estimates)

    def probabilities(self, rates: Float[Array, " masks"]) -> Float[Array, " masks"]:
        """Probability of drawing each mask [2^n], given their success rates."""
        full = jnp.zeros(len(rates)).at[-1].set(1.0)
        rule = probabilities_by_difficulty if self.mask_levels else mask_probabilities
        probabilities = rule(rates, self.c_g, self.kappa)
        return (1.0 - self.full_share) * probabilities + self.full_share * full

    def draw(
        self, state: CGMState, key: jax.Array, count: int
    ) -> tuple[Float[Array, "count n"], Float[Array, " count"]]:
        """Draw masks without a table: masks [count, n] and their estimated success rates."""
        mask_key, full_key = jax.random.split(key)
        rates = subgoal_rates(state.subgoals, self.c_g)
        rule = draw_masks_by_difficulty if self.mask_levels else draw_masks
        masks, estimates = rule(mask_key, rates, self.c_g, self.kappa, count)
        full = jax.random.bernoulli(full_key, self.full_share, (count,))
        return jnp.where(full[:, None], 1.0, masks), jnp.where(full, rates.prod(), estimates)


def joint_success_rates(
    masks: Float[Array, "masks n"], history: SuccessHistory, c_g: ArrayLike
) -> Float[Array, " masks"]:
    """Success rate [m] of every mask, without assuming that sub-goals are independent.

    Not in the paper, whose product this judges: the share of the history's rollouts that achieved
    all kept dimensions at once. Before any evaluation it is the paper's product.

    Args:
        masks: [m, n] of 0 and 1.
        history: outcomes of evaluation rollouts, of length h.
        c_g: the rate aimed at, scalar in [0, 1].
    """
    achieved = jnp.all((masks == 0) | (history.successes[:, None] > 0), axis=-1)  # [h, m]
    product = mask_success_rates(masks, subgoal_rates(history, c_g))
    return success_rates(SuccessHistory(achieved.astype(jnp.float32), history.count), product)
