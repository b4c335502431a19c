"""Difficulty first: masks of many dimensions by levels of success, and what a level practises.

    masks, estimates = draw_masks_by_difficulty(key, rates, c_g, kappa, count=16)
    report = report_levels(masks, estimates)

A method of this project, not of the paper. The paper weighs single masks, and nearly all masks of
many dimensions keep half of them: with all rates at 0.5, c_g = 0.1 and kappa = 32 the share of
draws with c_m in [0.05, 0.2] is 96 % at n = 3, 55 % at n = 12 and 0 % at n = 30. Here a difficulty
is drawn first, and then a uniform mask of that difficulty, so that the number of masks does not
count.

A difficulty is a success rate in whole percent, and a mask is of the one that its c_m is nearest
to. Masks are counted on a finer grid, of `LEVELS` levels of -log c_m. Dimension k descends
L_k = round(-log r_k / delta) levels, where the last level, c_m = 0.005, is the upper end of
difficulty 0. So whatever descends so far, rates of 0 included, is of difficulty 0. With S_k(d)
the share of the masks of k dimensions that descend exactly d levels, and T_k(d) at least d,

    S_k(d) = (S_{k-1}(d) + S_{k-1}(d - L_k)) / 2,    S_0(0) = 1,
    T_k(d) = (T_{k-1}(d) + T_{k-1}(d - L_k)) / 2,    T_k(d <= 0) = 1.

Walking back from a level, dimension k is kept with probability S_{k-1}(d - L_k) / (2 S_k(d)), or
with T where the mask is to descend at least d. delta = 0.0026, so rounding moves log c_m by up to
0.0013 for each kept dimension: a mask near a border may count for the difficulty beside it. Time
and memory grow with n * LEVELS. Up to ten dimensions, where all masks are in a table, difficulties
are those of the exact c_m.
"""

import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax.typing import ArrayLike
from jaxtyping import Array, Float, Int

from cgm_jax.config.missing import missing
from cgm_jax.curricula.parts.lookahead import log_weight

LEVELS = 2048
DIFFICULTIES = 101

REPORTED = 21
"""Success rates that masks are reported by: 0, 0.05, ..., 1."""

DELTA = -math.log(0.5 / (DIFFICULTIES - 1)) / (LEVELS - 1)
"""Height of a level in -log c_m."""

MAX_GOAL_SIZE = 120
"""Shares of down to 2^-n are float32."""


class LevelReport(NamedTuple):
    """What masks practise, by c_m in steps of 0.05: their share and the dimensions they keep, [21].

    Shares sum to 1. The mean number of kept dimensions is NaN where no mask is.
    """

    probability: jax.Array
    kept_dimensions: jax.Array


def draw_masks_by_difficulty(
    key: jax.Array, rates: Float[Array, " n"], c_g: ArrayLike, kappa: ArrayLike, count: int
) -> tuple[Float[Array, "count n"], Float[Array, " count"]]:
    """Draw a difficulty c, p(c) proportional to (1 - |c - c_g|)^kappa, and a uniform mask of it.

    Difficulties that no mask has are left out.

    Args:
        key: consumed.
        rates: success rate of each sub-goal, [n] in [0, 1].
        c_g: the rate aimed at, scalar in [0, 1].
        kappa: sharpness, scalar at least 0; 0 draws difficulties uniformly.
        count: number of masks E; static.

    Returns:
        Masks [E, n] float32 of 0 and 1, and their estimated success rates c_m [E].

    Raises:
        ValueError: more than 120 dimensions.
    """
    level_key, keep_key = jax.random.split(key)
    shares = count_masks(rates)
    probabilities = level_probabilities(shares[-1], c_g, kappa)
    levels = jax.random.choice(level_key, LEVELS, (count,), p=probabilities)
    uniform = jax.random.uniform(keep_key, (rates.shape[0], count))
    return walk_back(rates, shares, levels, uniform)


def count_masks(rates: Float[Array, " n"]) -> Float[Array, "n+1 2 levels"]:
    """Shares of the masks of the first k dimensions, by levels descended, [n + 1, 2, LEVELS].

    For k = 0, ..., n: the share that descends exactly d levels, S_k(d), and at least d, T_k(d).

    Raises:
        ValueError: more than 120 dimensions.
    """
    if rates.shape[0] > MAX_GOAL_SIZE:
        raise ValueError(f"goal_size: {rates.shape[0]} is above {MAX_GOAL_SIZE}")
    descents = jnp.arange(LEVELS)
    nothing_kept = jnp.stack([descents == 0, descents <= 0]).astype(jnp.float32)

    def step(shares: jax.Array, descent: jax.Array) -> tuple[jax.Array, jax.Array]:
        kept = _ahead(shares, jnp.arange(2)[:, None], descents - descent)
        shares = 0.5 * (shares + kept)
        return shares, shares

    _, rest = jax.lax.scan(step, nothing_kept, _descents(rates))
    return jnp.concatenate([nothing_kept[None], rest])


def level_probabilities(
    shares: Float[Array, "2 levels"], c_g: ArrayLike, kappa: ArrayLike
) -> Float[Array, " levels"]:
    """Probability of drawing a mask of each level, [LEVELS]; the last one is difficulty 0.

    Args:
        shares: of the masks of all dimensions, the last entry of `count_masks`, [2, LEVELS].
        c_g: the rate aimed at, scalar in [0, 1].
        kappa: sharpness, scalar at least 0.
    """
    exactly = shares[0].at[-1].set(shares[1, -1])
    success_rates = jnp.exp(-DELTA * jnp.arange(LEVELS, dtype=jnp.float32)).at[-1].set(0.0)
    return _difficulty_first(success_rates, exactly, c_g, kappa)


def probabilities_by_difficulty(
    success_rates: Float[Array, " m"], c_g: ArrayLike, kappa: ArrayLike
) -> Float[Array, " m"]:
    """Probability of drawing each mask where all of them are in a table, difficulty first.

    Args:
        success_rates: c_m, [m] in [0, 1].
        c_g: the rate aimed at, scalar in [0, 1].
        kappa: sharpness, scalar at least 0.
    """
    return _difficulty_first(success_rates, jnp.ones_like(success_rates), c_g, kappa)


def _difficulty_first(
    success_rates: Float[Array, " m"], shares: Float[Array, " m"], c_g: ArrayLike, kappa: ArrayLike
) -> Float[Array, " m"]:
    """Probabilities [m] of kinds of masks, given their success rates and how many there are."""
    difficulty = difficulty_of(success_rates)
    of_difficulty = jnp.zeros(DIFFICULTIES).at[difficulty].add(shares)
    weights = log_weight(jnp.linspace(0.0, 1.0, DIFFICULTIES), c_g, kappa)
    probabilities = jax.nn.softmax(jnp.where(of_difficulty > 0.0, weights, -jnp.inf))
    within = shares / jnp.where(of_difficulty > 0.0, of_difficulty, 1.0)[difficulty]
    return probabilities[difficulty] * within


def walk_back(
    rates: Float[Array, " n"],
    shares: Float[Array, "n+1 2 levels"],
    levels: Int[Array, " E"],
    uniform: Float[Array, "n E"],
) -> tuple[Float[Array, "E n"], Float[Array, " E"]]:
    """Uniform masks of given levels.

    Args:
        rates: [n] in [0, 1].
        shares: what `count_masks` returns for them.
        levels: one per mask, each a level that some mask has, [E] int32.
        uniform: in [0, 1), [n, E].

    Returns:
        Masks [E, n] float32 of 0 and 1, and their estimated success rates c_m [E].
    """
    kind = (levels == LEVELS - 1).astype(jnp.int32)

    def step(
        walk: tuple[jax.Array, jax.Array], given: tuple[jax.Array, ...]
    ) -> tuple[tuple[jax.Array, jax.Array], jax.Array]:
        left, estimates = walk
        shares, rate, descent, uniform = given
        kept = _ahead(shares, kind, left - descent)
        masked = shares[kind, left]
        keep = uniform * (kept + masked) < kept
        left = jnp.where(keep, jnp.maximum(left - descent, 0), left)
        return (left, jnp.where(keep, rate * estimates, estimates)), keep

    walk = (levels, jnp.ones(levels.shape[0]))
    given = (shares[:-1], rates, _descents(rates), uniform)
    (_, estimates), keep = jax.lax.scan(step, walk, given, reverse=True)
    return keep.T.astype(jnp.float32), estimates


def difficulty_of(estimates: Float[Array, " m"]) -> Int[Array, " m"]:
    """Index, int32, of the difficulty that a mask's c_m is nearest to."""
    return jnp.round(estimates * (DIFFICULTIES - 1)).astype(jnp.int32)


def report_levels(masks: Float[Array, "E n"], estimates: Float[Array, " E"]) -> LevelReport:
    """What many masks, drawn by whatever rule, practise.

    From 1,024 draws a share has a standard error of at most 1.6 percentage points.

    Args:
        masks: [E, n] of 0 and 1.
        estimates: their c_m, [E].
    """
    nearest = jnp.round(estimates * (REPORTED - 1)).astype(jnp.int32)
    counts = jax.nn.one_hot(nearest, REPORTED)
    kept = masks.sum(axis=-1) @ counts
    masks_of = counts.sum(axis=0)
    some = masks_of > 0.0
    mean = jnp.where(some, kept / jnp.where(some, masks_of, 1.0), missing())
    return LevelReport(masks_of / masks.shape[0], mean)


def _descents(rates: jax.Array) -> jax.Array:
    """Levels that keeping each dimension descends, [n] int32; the last one at most."""
    return jnp.clip(jnp.round(-jnp.log(rates) / DELTA), 0, LEVELS - 1).astype(jnp.int32)


def _ahead(shares: jax.Array, kind: jax.Array, descents: jax.Array) -> jax.Array:
    """Shares, of a row of `count_masks`, at descents that may be negative.

    To descend exactly a negative number of levels is impossible (kind 0); to descend at least so
    many is certain (kind 1).
    """
    found = shares[kind, jnp.maximum(descents, 0)]
    return jnp.where((descents >= 0) | (kind == 1), found, 0.0)
