"""Value disagreement sampling (VDS; Zhang, Abbeel and Pinto 2020): goals critics disagree about.

    p(g) proportional to std_i Q_i(s_0, pi(s_0, g), g)   over draws from the environment's goals

The standard deviation to the power of `disagreement_power`: 1 is the paper's choice, 2 the
variance, 0 uniform. What differs: the ensemble are the agent's own critics, where the paper trains
three value functions beside the agent, each on minibatches of its own; here all see the same. So
this wants three critics, which `--critics` sets if nothing else is asked for. DDPG's have a target
each. TD3's and SAC's share one, the least that any target critic expects: so they differ by how
they began alone, and `vds` changes the agent, too, whose target becomes the least of three instead
of two. The authors' value functions learn without hindsight, these with the agent's; and theirs are
clipped to the range of returns before they are compared, these are not. The paper takes 1,000
candidates.

    python -m cgm_jax.train --curriculum vds --critics 3
"""

from typing import ClassVar

import jax
import jax.numpy as jnp
from flax import struct
from jax.scipy.special import xlogy
from jaxtyping import Array, Float

from cgm_jax.config.fields import settings, shared, traced
from cgm_jax.config.missing import missing
from cgm_jax.config.sizes import Sizes
from cgm_jax.curricula.goid import GOID
from cgm_jax.curricula.protocol import Curriculum, Goals, Outcomes, View


class VDSState(struct.PyTreeNode):
    """How much critics disagree: mean over the last candidates, NaN at first; scalar."""

    disagreement: jax.Array


@settings
class VDS(Curriculum[VDSState]):
    """Goals critics disagree about. Its settings, with the names of the options."""

    wants_critics: ClassVar[int] = 3
    needs_critics: ClassVar[int] = 2

    disagreement_power: float = traced(1.0, "exponent of the critics' standard deviation", 0, 100)
    candidates: int = shared(GOID, "candidates")

    def init(self, sizes: Sizes) -> VDSState:
        """Nothing known yet."""
        del sizes
        return VDSState(jnp.full((), missing(), jnp.float32))

    def sample(self, state: VDSState, key: jax.Array, drawn: Goals, view: View) -> Goals:
        """Goals of the environment, by how much critics disagree about them."""
        del state
        candidate_key, choice_key = jax.random.split(key)
        candidates = view.draw(candidate_key, self.candidates)
        observation = view.first.obs["observation"]
        observations, goals = pairs(observation, candidates)
        disagreement = view.value(observations, goals).std(axis=0)  # [E, C]
        weights = log_weights(disagreement, self.disagreement_power)
        return drawn.replace(
            desired=candidates[jax.random.categorical(choice_key, weights)],
            memo=disagreement.mean().astype(jnp.float32),
        )

    def after_training(self, state: VDSState, outcomes: Outcomes) -> VDSState:
        """Remember how much critics disagreed."""
        now = jnp.where(outcomes.valid.any(), outcomes.goals.memo, state.disagreement)
        return VDSState(now)

    def report(self, state: VDSState) -> dict[str, jax.Array]:
        """The critics' mean standard deviation over the environment's goals."""
        return {"vds_disagreement": state.disagreement}


def log_weights(disagreement: Float[Array, "E C"], power: jax.Array | float) -> Float[Array, "E C"]:
    """Unnormalised log probabilities of goals [E, C] about which critics disagree so much.

    Uniform where they agree on all of them.
    """
    logits = xlogy(power, disagreement)
    possible = jnp.isfinite(logits).any(axis=-1, keepdims=True)
    return jnp.where(possible, logits, 0.0)


def pairs(
    observation: Float[Array, "E o"], goals: Float[Array, "C n"]
) -> tuple[Float[Array, "E C o"], Float[Array, "E C n"]]:
    """Every observation [E, o] with every goal [C, n]: [E, C, o] and [E, C, n]."""
    shape = (len(observation), len(goals))
    return (
        jnp.broadcast_to(observation[:, None], (*shape, observation.shape[-1])),
        jnp.broadcast_to(goals, (*shape, goals.shape[-1])),
    )
