"""Goals of intermediate difficulty (GOID; Florensa, Held, Geng and Abbeel 2018), without the GAN.

    g ~ uniform over { g : R_min <= R(g) <= R_max },   R(g) = success rate of the present policy

A share of the goals, a third as in the paper, are old ones that are not too hard (R >= R_min), so
that what was learned is not forgotten. Three things differ from the paper. Where it trains a GAN to
propose goals of that kind, candidates are goals that replay has achieved, of which those of that
kind are kept; they can be reached by construction. And where it evaluates the policy on each goal,
R(g) is the mean success of the training episodes whose goals were nearest to g. Its old goals come
from all iterations, each of them once and at some distance from all others; here they come from the
same recent training episodes (`practised_episodes`), and must not be too hard at present. While no
candidate is of intermediate difficulty, any of them is practised, as goals of the first policy are
in the paper; while replay is empty, the environment's own goals.

    python -m cgm_jax.train --curriculum goid --least-success 0.1 --most-success 0.9
"""

import jax
import jax.numpy as jnp
from flax import struct
from jaxtyping import Array, Float

from cgm_jax.config.fields import settings, static, traced
from cgm_jax.config.missing import missing
from cgm_jax.config.sizes import Sizes
from cgm_jax.curricula.parts.candidates import (
    achieved_goals,
    between,
    check_neighbours,
    draw_eligible,
    nearest_success,
)
from cgm_jax.curricula.parts.recent import Recent, init_recent, mean_of, record
from cgm_jax.curricula.protocol import Curriculum, Goals, Outcomes, View


class Practised(struct.PyTreeNode):
    """Goals [N, n] of training episodes, and whether they were achieved [N]."""

    goal: jax.Array
    success: jax.Array


class GOIDState(struct.PyTreeNode):
    """What is known of the difficulty of goals.

    Attributes:
        practised: recent training episodes.
        share: of the last candidates those of intermediate difficulty; NaN while there were none.
    """

    practised: Recent
    share: jax.Array


@settings
class GOID(Curriculum[GOIDState]):
    """Goals between too hard and too easy. Its settings, with the names of the options."""

    least_success: float = traced(0.1, "estimated success below which it is too hard", 0, 0.5)
    most_success: float = traced(0.9, "estimated success above which it is too easy", 0.5, 1)
    old_goal_share: float = traced(1 / 3, "share of goals that were practised before", 0, 1)
    neighbours: int = static(
        10, "nearest practised episodes behind an estimate of success", 1, 10**4
    )
    practised_episodes: int = static(500, "recent episodes to estimate success from", 1, 10**6)
    candidates: int = static(100, "goals among which to choose", 1, 10**5)

    def init(self, sizes: Sizes) -> GOIDState:
        """Nothing practised yet.

        Raises:
            SettingError: a single episode is to tell how often a goal succeeds.
        """
        check_neighbours(self.neighbours, self.practised_episodes)
        like = Practised(jnp.zeros(sizes.goal), jnp.zeros((), bool))
        return GOIDState(
            practised=init_recent(like, self.practised_episodes),
            share=jnp.full((), missing(), jnp.float32),
        )

    def sample(self, state: GOIDState, key: jax.Array, drawn: Goals, view: View) -> Goals:
        """Goals of intermediate difficulty, new and old."""
        candidate_key, new_key, old_key, mix_key = jax.random.split(key, 4)
        count = len(drawn.desired)
        candidates = achieved_goals(candidate_key, view, (self.candidates,))
        practised: Practised = state.practised.rows
        medium = between(self.rates(state, candidates), self.least_success, self.most_success)
        fair = self.rates(state, practised.goal) >= self.least_success
        fair &= state.practised.filled
        new = candidates[draw_eligible(new_key, medium, count)]
        old = practised.goal[draw_eligible(old_key, fair, count)]
        again = jax.random.bernoulli(mix_key, self.old_goal_share, (count,)) & fair.any()
        chosen = jnp.where(again[:, None], old, new)
        known = view.filled > 0
        return drawn.replace(
            desired=jnp.where(known, chosen, drawn.desired),
            memo=jnp.where(known, medium.mean(), missing()),
        )

    def after_training(self, state: GOIDState, outcomes: Outcomes) -> GOIDState:
        """Remember which goals were achieved."""
        practised = Practised(outcomes.goals.desired, outcomes.success)
        return GOIDState(
            practised=record(state.practised, practised, outcomes.valid),
            share=jnp.where(outcomes.valid.any(), outcomes.goals.memo, state.share),
        )

    def report(self, state: GOIDState) -> dict[str, jax.Array]:
        """Share of candidates of intermediate difficulty, and success of the practised goals."""
        return {
            "goid_share": state.share,
            "goid_success": mean_of(state.practised, state.practised.rows.success),
        }

    def rates(self, state: GOIDState, goals: Float[Array, "m n"]) -> Float[Array, " m"]:
        """Estimated success rate [m] of goals [m, n]; NaN before any training episode."""
        practised: Practised = state.practised.rows
        return nearest_success(
            goals, practised.goal, practised.success, state.practised.filled, self.neighbours
        )
