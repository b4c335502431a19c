"""The paper's distribution of masks for goals of many dimensions, without a table of 2^n masks.

The twin in numpy of curricula/parts/lookahead.py, which explains it. Dimensions are decided one
after the other; V_k(c) is the summed weight of all ways to decide dimensions k, ..., n - 1 where
those kept so far have the success rate c:

    V_n(c) = (1 - |c - c_g|)^kappa,    V_k(c) = V_{k+1}(c) + V_{k+1}(r_k c)

and dimension k is kept with probability V_{k+1}(r_k c) / V_k(c). log V is interpolated between
`LEVELS` success rates; what that blunts is made up for by Metropolis and Hastings' rule over
`CANDIDATES` proposals. Time and memory grow with n * LEVELS.
"""

from typing import NamedTuple

import numpy as np

from cgm_jax.gymnasium.mask_table import log_power, log_weights

LEVELS = 1024
CANDIDATES = 4

NEVER = -1e30
"""Log weight of a mask that must not be drawn; finite, so that no difference of two is NaN."""


class Proposal(NamedTuple):
    """Masks [E, n] bool, their c_m [E], and the log probability of proposing each [E]."""

    masks: np.ndarray
    estimates: np.ndarray
    log_probability: np.ndarray


class MaskLookahead:
    """p(m) proportional to (1 - |c_m - c_g|)^kappa, for sub-goals that succeed independently."""

    def __init__(self, rates: np.ndarray, c_g: float, kappa: float) -> None:
        """Tabulate what lies ahead of every decision.

        Args:
            rates: success rate of every sub-goal, [n] in [0, 1].
            c_g: the rate aimed at.
            kappa: sharpness.
        """
        self._rates, self._c_g, self._kappa = rates, c_g, kappa
        levels = np.linspace(0.0, 1.0, LEVELS)
        self._tables: list[np.ndarray] = []  # log V_{n-1}, ..., log V_1
        for k in range(len(rates) - 1, 0, -1):
            masked, kept = (self._log_ahead(k + 1, c) for c in (levels, rates[k] * levels))
            self._tables.append(np.logaddexp(masked, kept))

    @property
    def full_goal_probability(self) -> float:
        """Probability of drawing the full goal, as it is proposed."""
        always = np.full((len(self._rates), 1), -1.0)
        return float(np.exp(self.propose(always).log_probability[0]))

    def draw(self, generator: np.random.Generator, count: int) -> np.ndarray:
        """Draw masks, [count, n] bool."""
        uniform = generator.random((len(self._rates), CANDIDATES * count))
        proposal = self.propose(uniform)
        excess = self._log_weight(proposal.estimates) - proposal.log_probability
        excess = excess.reshape(CANDIDATES, count)
        log_uniform = -generator.exponential(size=(CANDIDATES, count))
        kept, rows = np.zeros(count, int), np.arange(count)
        for candidate in range(1, CANDIDATES):
            accepted = log_uniform[candidate] < excess[candidate] - excess[kept, rows]
            kept = np.where(accepted, candidate, kept)
        return proposal.masks.reshape(CANDIDATES, count, -1)[kept, rows]

    def propose(self, uniform: np.ndarray) -> Proposal:
        """Decide every dimension in order, looking ahead by the tables.

        Args:
            uniform: a dimension is kept where its number is below the probability of keeping it,
                [n, E]; uniform in [0, 1) to draw, below 0 to keep and at least 1 to mask
                regardless.
        """
        estimates, log_probability = np.ones(uniform.shape[1]), np.zeros(uniform.shape[1])
        masks = np.empty(uniform.shape, bool)
        for k, rate in enumerate(self._rates):
            masked, kept = (self._log_ahead(k + 1, c) for c in (estimates, rate * estimates))
            log_odds = kept - masked
            log_keep = -np.logaddexp(0.0, -log_odds)
            masks[k] = uniform[k] < np.exp(log_keep)
            log_probability += np.where(masks[k], log_keep, log_keep - log_odds)
            estimates = np.where(masks[k], rate * estimates, estimates)
        return Proposal(masks.T, estimates, log_probability)

    def _log_ahead(self, k: int, success_rates: np.ndarray) -> np.ndarray:
        """Log V_k at success rates [...]."""
        if k == len(self._rates):
            return self._log_weight(success_rates)
        return self._interpolate(self._tables[len(self._rates) - 1 - k], success_rates)

    def _log_weight(self, success_rates: np.ndarray) -> np.ndarray:
        return np.maximum(log_weights(success_rates, self._c_g, self._kappa), NEVER)

    def _interpolate(self, table: np.ndarray, success_rates: np.ndarray) -> np.ndarray:
        position = success_rates * (LEVELS - 1)
        index = np.clip(position.astype(int), 0, LEVELS - 2)
        share = position - index
        below, above = table[index], table[index + 1]
        between = below * (1.0 - share) + above * share
        # V is 0 at an end of [0, 1] only where all weights ahead vanish there, as a power of kappa.
        from_zero = np.maximum(above + log_power(share, self._kappa), NEVER)
        to_zero = np.maximum(below + log_power(1.0 - share, self._kappa), NEVER)
        between = np.where(below <= 0.5 * NEVER, from_zero, between)
        return np.where(above <= 0.5 * NEVER, to_zero, between)
