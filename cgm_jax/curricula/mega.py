"""Maximum entropy gain (MEGA and OMEGA; Pitis, Chan, Zhao, Stadie and Ba 2020): the frontier.

    MEGA:   argmin over candidates with Q(s_0, g) >= cutoff of p_ag(g)
    OMEGA:  with probability alpha = 1 / max(b + KL(p_dg || p_ag), 1) the environment's goal, if
            its Q is at least the cutoff; else MEGA's

Candidates are drawn from the goals that replay achieved; p_ag and p_dg are kernel densities of
achieved goals and of the environment's goals, standardised by the achieved ones. As in the authors'
program (mrl): bandwidth 0.1, b = -3, KL as the mean over draws from p_dg; the cutoff falls by 1
where at least 70 % of ten episodes succeed and rises by 1 where at most 30 % do, within [-(1 -
gamma^(0.8 T)) / (1 - gamma), -3], gamma at most 0.99, and never below a candidate's lowest Q so
far; if no candidate reaches it, that of the highest Q. What differs: success is that of the last
step, where mrl's is that of any step; Q is the mean over critics; mrl has 10,000 goals behind p_ag,
and asks for p_dg at the very goals, a thousand as here, that are behind it. That makes KL
too large, by 4 for equal normal distributions of three dimensions and a thousand goals; here each
goal is left out of its own density. mrl's random exploration after success ("go explore") is not
part of choosing goals and is left out. With a large `omega_bonus` OMEGA is MEGA.

The cutoff and its limits are returns of rewards of -1 or 0, so that an environment with rewards of
its own is refused. SAC's critics expect the entropy of future actions besides, weighed by the
temperature: near uniform actions it lifts all values, even beyond 0, so that more goals count as
reachable; where it is negative, as its default aim is, it lowers them. So with SAC a cutoff does
not stand for a number of steps.

    python -m cgm_jax.train --curriculum mega --candidates 100
"""

from typing import ClassVar, NamedTuple

import jax
import jax.numpy as jnp
from flax import struct
from jax.typing import ArrayLike
from jaxtyping import Array, Float, Int

from cgm_jax.config.common import Common
from cgm_jax.config.fields import settings, shared, static, traced
from cgm_jax.config.missing import missing
from cgm_jax.config.sizes import Sizes
from cgm_jax.curricula.goid import GOID
from cgm_jax.curricula.parts.candidates import achieved_goals
from cgm_jax.curricula.parts.density import log_density, log_density_of_others
from cgm_jax.curricula.parts.recent import Recent, init_recent, mean_of, record
from cgm_jax.curricula.protocol import Curriculum, Goals, Outcomes, View

CUTOFF_EPISODES = 10
"""Episodes that decide whether the cutoff moves."""

EASY, HARD = 0.7, 0.3
"""Success of these episodes from which on it falls, and up to which it rises."""

REACHED_WITHIN = 0.8
"""Share of an episode's steps within which a goal must be reached at least."""

MAX_DISCOUNT = 0.99
MIN_DEVIATION = 0.002
"""What is added to the standard deviation of achieved goals, in distance thresholds: on Fetch the
1e-4 m that mrl adds."""


class Memo(NamedTuple):
    """What choosing goals has shown, scalars.

    Attributes:
        alpha: NaN while replay is empty.
        lowest_value: of a candidate; infinite while there is none.
    """

    alpha: jax.Array
    lowest_value: jax.Array


class MEGAState(struct.PyTreeNode):
    """What decides which goals count as reachable.

    Attributes:
        cutoff: value of a goal from which on it does, scalar.
        lower: how far the cutoff may fall at present, scalar; never below `floor`.
        floor: value of a goal that takes most of an episode, scalar.
        successes: of the training episodes since the cutoff last moved, up to ten.
        alpha: of the last cycle; NaN while replay was empty.
    """

    cutoff: jax.Array
    lower: jax.Array
    floor: jax.Array
    successes: Recent
    alpha: jax.Array


@settings
class MEGA(Curriculum[MEGAState]):
    """Rare goals within reach. Its settings, with the names of the options."""

    needs_critics: ClassVar[int] = 1
    needs_sparse_rewards: ClassVar[bool] = True

    density_bandwidth: float = traced(0.1, "bandwidth of densities of standardised goals", 1e-3, 10)
    omega_bonus: float = traced(-3.0, "b of OMEGA; the smaller, the more of the task's goals")
    initial_cutoff: float = traced(-3.0, "value from which on a goal counts as reachable", high=0)
    discount: float = shared(Common, "discount")
    candidates: int = shared(GOID, "candidates")
    density_samples: int = static(1000, "goals behind a density", 2, 10**5)

    def init(self, sizes: Sizes) -> MEGAState:
        """The initial cutoff."""
        gamma = jnp.minimum(jnp.asarray(self.discount, jnp.float32), MAX_DISCOUNT)
        floor = -(1.0 - gamma ** (REACHED_WITHIN * sizes.episode_length)) / (1.0 - gamma)
        cutoff = jnp.maximum(self.initial_cutoff, floor)
        return MEGAState(
            cutoff=cutoff,
            lower=cutoff,
            floor=floor,
            successes=init_recent(jnp.zeros((), bool), CUTOFF_EPISODES),
            alpha=jnp.full((), missing(), jnp.float32),
        )

    def sample(self, state: MEGAState, key: jax.Array, drawn: Goals, view: View) -> Goals:
        """The environment's goals, or the rarest that can be reached."""
        candidate_key, achieved_key, drawn_key, mix_key = jax.random.split(key, 4)
        count = len(drawn.desired)
        candidates = achieved_goals(candidate_key, view, (count, self.candidates))
        achieved = achieved_goals(achieved_key, view, (self.density_samples,))
        least = MIN_DEVIATION * drawn.threshold[0]
        mean, deviation = achieved.mean(axis=0), achieved.std(axis=0) + least
        achieved = (achieved - mean) / deviation
        density = log_density((candidates - mean) / deviation, achieved, self.density_bandwidth)

        observation = view.first.obs["observation"]
        several = jnp.broadcast_to(
            observation[:, None], (count, self.candidates, observation.shape[-1])
        )
        values = view.value(several, candidates).mean(axis=0)
        frontier = candidates[jnp.arange(count), rarest_reachable(density, values, state.cutoff)]

        target = (view.draw(drawn_key, self.density_samples) - mean) / deviation
        divergence = jnp.mean(
            log_density_of_others(target, self.density_bandwidth)
            - log_density(target, achieved, self.density_bandwidth)
        )
        alpha = 1.0 / jnp.maximum(self.omega_bonus + divergence, 1.0)
        within_reach = view.value(observation, drawn.desired).mean(axis=0) >= state.cutoff
        kept = within_reach & jax.random.bernoulli(mix_key, alpha, (count,))
        known = view.filled > 0
        return drawn.replace(
            desired=jnp.where((known & ~kept)[:, None], frontier, drawn.desired),
            memo=Memo(jnp.where(known, alpha, missing()), jnp.where(known, values.min(), jnp.inf)),
        )

    def after_training(self, state: MEGAState, outcomes: Outcomes) -> MEGAState:
        """Move the cutoff by how many of the last episodes succeeded."""
        happened, memo = outcomes.valid.any(), outcomes.goals.memo
        successes = record(state.successes, outcomes.success, outcomes.valid)
        enough = happened & successes.filled.all()
        rate = mean_of(successes, successes.rows)
        easy, hard = enough & (rate >= EASY), enough & (rate <= HARD)
        lower = jnp.maximum(state.floor, jnp.minimum(memo.lowest_value, state.lower))
        lower = jnp.where(enough, lower, state.lower)
        higher = jnp.maximum(jnp.minimum(self.initial_cutoff, state.cutoff + 1.0), state.floor)
        cutoff = jnp.where(easy, jnp.maximum(lower, state.cutoff - 1.0), state.cutoff)
        recorded = jnp.where(easy | hard, 0, successes.recorded)
        now = state.replace(
            cutoff=jnp.where(hard, higher, cutoff),
            lower=lower,
            successes=successes.replace(recorded=recorded),
            alpha=jnp.where(happened, memo.alpha, state.alpha),
        )
        # With jax_enable_x64 values and settings may be of float64.
        return jax.tree.map(lambda new, old: new.astype(old.dtype), now, state)

    def report(self, state: MEGAState) -> dict[str, jax.Array]:
        """The chance of the environment's own goals, and the cutoff."""
        return {"omega_alpha": state.alpha, "mega_cutoff": state.cutoff}


def rarest_reachable(
    density: Float[Array, "E C"], values: Float[Array, "E C"], cutoff: ArrayLike
) -> Int[Array, " E"]:
    """Index [E] of the candidate to practise.

    Args:
        density: of each candidate or its logarithm, [E, C].
        values: what the critics expect of it, [E, C].
        cutoff: value from which on it counts as reachable.

    Returns:
        The least dense of those that can be reached; where none can, that of the highest value.
    """
    reachable = values >= cutoff
    rarest = jnp.argmin(jnp.where(reachable, density, jnp.inf), axis=1)
    return jnp.where(reachable.any(axis=1), rarest, jnp.argmax(values, axis=1))
