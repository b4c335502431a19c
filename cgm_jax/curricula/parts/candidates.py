"""What curricula over goals and starts choose among, and how likely it succeeds."""

import jax
import jax.numpy as jnp
from jax.typing import ArrayLike
from jaxtyping import Array, Bool, Float, Int

from cgm_jax.config.fields import SettingError
from cgm_jax.config.missing import missing
from cgm_jax.curricula.protocol import View


def achieved_goals(key: jax.Array, view: View, shape: tuple[int, ...]) -> jax.Array:
    """Goals [*shape, n] that replay's episodes achieved: of any episode, at any of its steps.

    Both are drawn uniformly; what is repeated after an early end is not among them. Zeros while
    replay is empty.
    """
    episode_key, step_key = jax.random.split(key)
    episode = jax.random.randint(episode_key, shape, 0, jnp.maximum(view.filled, 1))
    last = view.achieved.shape[1] - 1 if view.steps is None else view.steps[episode]
    step = jax.random.randint(step_key, shape, 0, last + 1)
    return view.achieved[episode, step]


def nearest_success(
    points: Float[Array, "m d"],
    practised: Float[Array, "N d"],
    success: Bool[Array, " N"],
    filled: Bool[Array, " N"],
    neighbours: int,
) -> Float[Array, " m"]:
    """Estimated success rate [m] of points: the mean over the nearest that were practised.

    Args:
        points: [m, d].
        practised: [N, d].
        success: of what was practised, [N] bool.
        filled: which rows of both are real, [N] bool.
        neighbours: how many to average over, or all there are if those are fewer.

    Returns:
        NaN where nothing was practised, which compares false with anything.
    """
    squares = jnp.sum(jnp.square(points[:, None] - practised), axis=-1)  # [m, N]
    closeness = jnp.where(filled, -squares, -jnp.inf)
    nearest_closeness, nearest = jax.lax.top_k(closeness, min(neighbours, len(practised)))
    known = jnp.isfinite(nearest_closeness)
    count, total = known.sum(axis=1), jnp.sum(known & success[nearest], axis=1)
    return jnp.where(count > 0, total / jnp.maximum(count, 1), missing())


def check_neighbours(neighbours: int, practised_episodes: int) -> None:
    """Check that a success rate can be told from so many episodes.

    Raises:
        SettingError: it would always be 0 or 1, so that nothing were of medium success.
    """
    for name, number in (("neighbours", neighbours), ("practised_episodes", practised_episodes)):
        if number < 2:
            raise SettingError(
                f"{name}: the success of {number} episode is 0 or 1, never medium; give at least 2"
            )


def between(rates: Float[Array, " m"], least: ArrayLike, most: ArrayLike) -> Bool[Array, " m"]:
    """Which success rates are neither too low nor too high; those that are NaN are not."""
    return (rates >= least) & (rates <= most)


def draw_eligible(key: jax.Array, eligible: Bool[Array, " m"], count: int) -> Int[Array, " count"]:
    """Indices [count], uniform among the eligible ones of [m]; among all if there is none."""
    logits = jnp.where(eligible | ~eligible.any(), 0.0, -jnp.inf)
    return jax.random.categorical(key, logits, shape=(count,))
