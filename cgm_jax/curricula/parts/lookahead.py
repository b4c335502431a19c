"""The paper's distribution of masks for goals of many dimensions, without a table of 2^n masks.

    masks, estimates = draw_masks(key, rates, c_g, kappa, count=16)

Dimensions are decided one after the other. What a decision needs is how much weight lies ahead of
it: V_k(c), the summed weight of all ways to decide dimensions k, ..., n - 1, where the dimensions
kept so far have the success rate c. With w(c) = (1 - |c - c_g|)^kappa,

    V_n(c) = w(c),    V_k(c) = V_{k+1}(c) + V_{k+1}(r_k c),

and dimension k is kept with probability V_{k+1}(r_k c) / V_k(c). The success rate of the mask that
is being drawn stays exact; V is tabulated at `LEVELS` success rates, evenly spaced over [0, 1], and
log V is interpolated linearly between them. So rates of 0 and 1 are exact, and no last level has to
collect what lies beyond the grid.

Interpolation blunts the peak of a sharp weight: at kappa = 1000 it alone can be 0.1 off in total
variation. Each mask is therefore the last of `CANDIDATES` proposals, each of which replaces the one
before it by the rule of Metropolis and Hastings, with the true weight of its exact c_m. Up to
n = 10 the tests then find a total variation of at most 0.005 from the paper's probabilities, for
kappa from 0 to 1000, rates of 0 and 1 included. Time and memory grow with n * LEVELS.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax.scipy.special import xlogy
from jax.typing import ArrayLike

LEVELS = 1024
CANDIDATES = 4

_NEVER = -1e30
"""Log weight of a mask that must not be drawn; finite, so that no difference of two is NaN."""


class Proposal(NamedTuple):
    """Masks [E, n] of 0 and 1, their c_m [E], and the log probability of proposing each [E]."""

    masks: jax.Array
    estimates: jax.Array
    log_probability: jax.Array


def draw_masks(
    key: jax.Array, rates: jax.Array, c_g: ArrayLike, kappa: ArrayLike, count: int
) -> tuple[jax.Array, jax.Array]:
    """Draw masks with p(m) proportional to (1 - |c_m - c_g|)^kappa (section III of the paper).

    c_m is the product of the rates of the kept dimensions: sub-goals count as independent.

    Args:
        key: consumed.
        rates: success rate of each sub-goal, [n] in [0, 1].
        c_g: the rate aimed at, scalar in [0, 1].
        kappa: sharpness, scalar at least 0; 0 draws masks uniformly.
        count: number of masks E; static.

    Returns:
        Masks [E, n] float32 of 0 and 1, and their estimated success rates c_m [E]. Where every
        mask has weight 0, all c_m being at the opposite end of [0, 1] from c_g, masks are uniform.
    """
    propose_key, accept_key = jax.random.split(key)
    uniform = jax.random.uniform(propose_key, (rates.shape[0], CANDIDATES * count))
    proposal = propose(rates, c_g, kappa, uniform)
    excess = log_weight(proposal.estimates, c_g, kappa) - proposal.log_probability
    masks, estimates, excess = (
        array.reshape(CANDIDATES, count, *array.shape[1:])
        for array in (proposal.masks, proposal.estimates, excess)
    )
    log_uniform = -jax.random.exponential(accept_key, (CANDIDATES, count))
    kept = jnp.zeros(count, jnp.int32)
    kept_excess = excess[0]
    for candidate in range(1, CANDIDATES):
        accepted = log_uniform[candidate] < excess[candidate] - kept_excess
        kept = jnp.where(accepted, candidate, kept)
        kept_excess = jnp.where(accepted, excess[candidate], kept_excess)
    rows = jnp.arange(count)
    return masks[kept, rows], estimates[kept, rows]


def propose(rates: jax.Array, c_g: ArrayLike, kappa: ArrayLike, uniform: jax.Array) -> Proposal:
    """Decide every dimension in order, looking ahead by the tables.

    Args:
        rates: [n] in [0, 1].
        c_g: scalar in [0, 1].
        kappa: scalar at least 0.
        uniform: a dimension is kept where its number is below the probability of keeping it,
            [n, E]; uniform in [0, 1) to draw, below 0 to keep and at least 1 to mask regardless.
    """
    walk = (jnp.zeros(uniform.shape[1]) + 1.0, jnp.zeros(uniform.shape[1]))

    def decide(
        walk: tuple[jax.Array, jax.Array], rate: jax.Array, uniform: jax.Array, log_odds: jax.Array
    ) -> tuple[tuple[jax.Array, jax.Array], jax.Array]:
        estimates, log_probability = walk
        keep = uniform < jax.nn.sigmoid(log_odds)
        log_probability += jax.nn.log_sigmoid(jnp.where(keep, log_odds, -log_odds))
        return (jnp.where(keep, rate * estimates, estimates), log_probability), keep

    def by_table(
        walk: tuple[jax.Array, jax.Array], given: tuple[jax.Array, jax.Array, jax.Array]
    ) -> tuple[tuple[jax.Array, jax.Array], jax.Array]:
        rate, uniform, table = given
        log_odds = _interpolate(table, rate * walk[0], kappa)
        log_odds -= _interpolate(table, walk[0], kappa)
        return decide(walk, rate, uniform, log_odds)

    tables = look_ahead(rates, c_g, kappa)
    walk, keep = jax.lax.scan(by_table, walk, (rates[:-1], uniform[:-1], tables))
    log_odds = log_weight(rates[-1] * walk[0], c_g, kappa) - log_weight(walk[0], c_g, kappa)
    walk, keep_last = decide(walk, rates[-1], uniform[-1], log_odds)
    masks = jnp.concatenate([keep, keep_last[None]]).T.astype(jnp.float32)
    return Proposal(masks, *walk)


def look_ahead(rates: jax.Array, c_g: ArrayLike, kappa: ArrayLike) -> jax.Array:
    """Log V_1, ..., log V_{n-1} at the levels, [n - 1, LEVELS]."""
    levels = jnp.linspace(0.0, 1.0, LEVELS)

    def step(table: jax.Array, rate: jax.Array) -> tuple[jax.Array, jax.Array]:
        return jnp.logaddexp(table, _interpolate(table, rate * levels, kappa)), table

    # The last dimension from exact weights, as there is where peaks are sharpest.
    last = jnp.logaddexp(log_weight(levels, c_g, kappa), log_weight(rates[-1] * levels, c_g, kappa))
    return jax.lax.scan(step, last, rates[:-1], reverse=True)[1]


def log_weight(success_rates: jax.Array, c_g: ArrayLike, kappa: ArrayLike) -> jax.Array:
    """Log of (1 - |c_m - c_g|)^kappa, and -1e30 for a weight of 0."""
    closeness = 1.0 - jnp.abs(success_rates - c_g)
    impossible = (closeness <= 0.0) & (jnp.asarray(kappa) > 0.0)
    return jnp.where(impossible, _NEVER, xlogy(kappa, jnp.where(impossible, 1.0, closeness)))


def _interpolate(table: jax.Array, success_rates: jax.Array, kappa: ArrayLike) -> jax.Array:
    position = success_rates * (LEVELS - 1)
    index = jnp.clip(position.astype(jnp.int32), 0, LEVELS - 2)
    share = position - index.astype(position.dtype)
    below, above = table[index], table[index + 1]
    between = below * (1.0 - share) + above * share
    # V is 0 at an end of [0, 1] only where all weights ahead vanish there, as a power of kappa.
    from_zero = jnp.maximum(above + xlogy(kappa, share), _NEVER)
    to_zero = jnp.maximum(below + xlogy(kappa, 1.0 - share), _NEVER)
    between = jnp.where(below <= 0.5 * _NEVER, from_zero, between)
    return jnp.where(above <= 0.5 * _NEVER, to_zero, between)
