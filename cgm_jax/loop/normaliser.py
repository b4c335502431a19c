"""Running mean and standard deviation of what the networks see.

The statistics are Brax's; this module decides what feeds them. One NaN row would poison them
for good, so rows of dropped episodes get no weight and a harmless value.

Nothing here depends on the unit or the origin of the data. The implementation that the paper
builds on (OpenAI baselines) clips raw values to +-200 and divides by at least 0.01, which is made
for metres near the origin. Here raw values are not clipped, and the environment's distance
threshold is the yardstick of the floor (0.01 m on Fetch) and of what to divide by before any data
(1 m).
"""

# Brax types the parts of its statistics as unknown.
# pyright: reportAttributeAccessIssue=false, reportArgumentType=false, reportOperatorIssue=false

from collections.abc import Mapping

import jax
import jax.numpy as jnp
from brax.training.acme import running_statistics
from brax.training.acme.running_statistics import RunningStatisticsState
from flax import struct
from jax.typing import ArrayLike
from jaxtyping import Array, Bool, Float

from cgm_jax.replay.ring import Episodes, steps_taken

INITIAL = 20.0
"""Standard deviation before any data, in distance thresholds."""

FAR = 1000.0
"""Data farther from 0 than this many distance thresholds are summed from an origin of their own."""

PRECISION = 1e-6
"""A standard deviation below this share of the mean is rounding of float32, not motion."""


class Normaliser(struct.PyTreeNode):
    """Statistics of observations and of goals.

    Attributes:
        observation: of observations.
        goal: of desired and achieved goals.
        limit: normalised values are clipped to +-this, scalar.
    """

    observation: RunningStatisticsState
    goal: RunningStatisticsState
    limit: jax.Array


def init_normaliser(
    observation_size: int, goal_size: int, *, limit: ArrayLike, distance_threshold: float
) -> Normaliser:
    """Statistics that have seen nothing."""
    return Normaliser(
        observation=_init_statistics(observation_size, distance_threshold),
        goal=_init_statistics(goal_size, distance_threshold),
        limit=jnp.asarray(limit, jnp.float32),
    )


def observe(
    normaliser: Normaliser,
    episodes: Episodes,
    valid: Bool[Array, " episodes"],
    drawn_goal: Float[Array, "episodes n"],
    *,
    floor: float,
    distance_threshold: float,
) -> Normaliser:
    """Take in new episodes.

    Goals are fed from both kinds that the networks see: desired and achieved ones. Of the desired
    ones every other row is what the environment drew, which evaluation asks for, in place of what a
    curriculum has chosen: that may be achieved goals alone, to which all others look alike. Of an
    episode that ended early the states up to its end count, not the copies of its last one.

    Args:
        normaliser: before.
        episodes: the new ones.
        valid: which of them count, [episodes] bool.
        drawn_goal: what the environment drew, [episodes, n].
        floor: least standard deviation, in distance thresholds.
        distance_threshold: of the environment, in the unit of its goals.
    """
    length = episodes.action.shape[1]
    places = jnp.arange(len(drawn_goal))[:, None] + jnp.arange(length)
    chosen = (places % 2 == 0)[..., None]
    desired = jnp.where(chosen, episodes.desired_goal[:, None], drawn_goal[:, None])
    goals = jnp.concatenate([desired, episodes.achieved_goal[:, 1:]], axis=1)
    scales = (floor * distance_threshold, FAR * distance_threshold)
    states, steps = valid[:, None], valid[:, None]
    taken = steps_taken(episodes)
    if taken is not None:
        states = states & (jnp.arange(length + 1) <= taken[:, None])
        steps = jnp.tile(states[:, 1:], 2)  # both kinds of goals alike
    return normaliser.replace(
        observation=_update(normaliser.observation, episodes.observation, states, *scales),
        goal=_update(normaliser.goal, goals, steps, *scales),
    )


def with_statistics(
    normaliser: Normaliser, statistics: Mapping[str, ArrayLike], rows: int
) -> Normaliser:
    """A normaliser with other statistics, as if they came from so many rows.

    Args:
        normaliser: before.
        statistics: `observation_mean`, `observation_std` [observation_size], `goal_mean` and
            `goal_std` [goal_size], as policy files have them.
        rows: how much they count against what is observed from now on, below 2^32.
    """

    def taken(kind: str) -> RunningStatisticsState:
        mean, std = (jnp.asarray(statistics[f"{kind}_{part}"]) for part in ("mean", "std"))
        own = getattr(normaliser, kind)
        count = own.count.replace(
            hi=jnp.zeros_like(own.count.hi), lo=jnp.full_like(own.count.lo, rows)
        )
        squares = jnp.square(std) * rows
        return own.replace(mean=mean, std=std, count=count, summed_variance=squares)

    return normaliser.replace(observation=taken("observation"), goal=taken("goal"))


def network_input(
    normaliser: Normaliser, observation: Float[Array, "*batch o"], goal: Float[Array, "*batch n"]
) -> Float[Array, "*batch o+n"]:
    """Normalised observation and goal, [..., observation_size + goal_size]."""
    pairs = ((normaliser.observation, observation), (normaliser.goal, goal))
    parts = [(rows - statistics.mean) / statistics.std for statistics, rows in pairs]
    return jnp.clip(jnp.concatenate(parts, axis=-1), -normaliser.limit, normaliser.limit)


def _init_statistics(size: int, distance_threshold: float) -> RunningStatisticsState:
    # The default std_eps is a Python number, whose weak type would not survive the first epoch
    # and would make the second one compile anew.
    state = running_statistics.init_state(jnp.zeros(size), std_eps=jnp.zeros(()))  # pyright: ignore
    return state.replace(std=jnp.full_like(state.mean, INITIAL * distance_threshold))


def _update(
    statistics: RunningStatisticsState,
    rows: jax.Array,
    counted: jax.Array,
    floor: float,
    far: float,
) -> RunningStatisticsState:
    """Update with rows [episodes, steps, size] where they are counted, [episodes, steps or 1]."""
    usable = jnp.broadcast_to(counted, rows.shape[:2]) & jnp.isfinite(rows).all(axis=-1)
    with jax.numpy_dtype_promotion("standard"):  # Brax has JAX turn its counts into floats
        updated = running_statistics.update(
            statistics.replace(mean=_origin(statistics, rows, usable, far)),
            jnp.where(usable[..., None], rows, 0.0),
            weights=usable.astype(jnp.float32),
            std_min_value=0.0,
            std_max_value=float(jnp.finfo(jnp.float32).max),
        )
    updated = updated.replace(std=_floored(updated, floor, statistics.std))
    # With no row at all the update divides by a count of zero.
    return jax.tree.map(
        lambda new, old: jnp.where(usable.any(), new, old).astype(jnp.asarray(old).dtype),
        updated,
        statistics,
    )


def _origin(
    statistics: RunningStatisticsState, rows: jax.Array, usable: jax.Array, far: float
) -> jax.Array:
    """Where the sums start: at 0, or at the first row where the data lie far from 0.

    Sums of squares around 0 would lose all digits of what varies (float32 has seven).
    """
    first = rows.reshape(-1, rows.shape[-1])[jnp.argmax(usable)]
    nothing_seen = (statistics.count.hi == 0) & (statistics.count.lo == 0)  # pyright: ignore
    return jnp.where(nothing_seen & usable.any() & (jnp.abs(first) > far), first, statistics.mean)


def _floored(statistics: RunningStatisticsState, floor: float, before: jax.Array) -> jax.Array:
    """Standard deviations [size] by which to divide, above 0.

    At least `floor`, unless even the entry that varies most varies less: observations may have a
    smaller unit than goals. Never within the rounding of the mean. Where that leaves 0, as of an
    entry that was always 0 without a floor, what it was `before`: any divisor gives 0.
    """
    std: jax.Array = statistics.std  # pyright: ignore[reportAssignmentType]
    most = std.max()
    least = jnp.where(most > 0.0, jnp.minimum(floor, most), floor)
    floored = jnp.maximum(jnp.maximum(std, least), PRECISION * jnp.abs(statistics.mean))
    if floor >= jnp.finfo(jnp.float32).tiny:
        return floored
    return jnp.where(floored > 0.0, floored, before)
