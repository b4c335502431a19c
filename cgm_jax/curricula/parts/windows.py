"""What became of the latest episodes of each thing to practise: success, and its change.

Things are masks or thresholds, by number. As Colas et al. (2019, CURIOUS) and Fournier et al. do,
progress compares the two halves of a window: the success rate over the newer half of the episodes
less that over the older half.
"""

import jax
import jax.numpy as jnp
from flax import struct
from jax.typing import ArrayLike
from jaxtyping import Array, Bool, Float, Int


class Windows(struct.PyTreeNode):
    """Outcomes of the latest w episodes of each thing.

    Attributes:
        successes: 0 or 1, a ring for each thing, [things, w].
        inserted: episodes of each thing so far, int32 [things]. Episode i lies in slot i mod w.
    """

    successes: jax.Array
    inserted: jax.Array


def init_windows(things: int, length: int) -> Windows:
    """Windows over the latest `length` episodes that have seen none."""
    return Windows(jnp.zeros((things, length)), jnp.zeros(things, jnp.int32))


def record_episodes(
    windows: Windows,
    thing: Int[Array, " E"],
    success: Bool[Array, " E"],
    valid: Bool[Array, " E"],
) -> Windows:
    """Append a batch of episodes, in order; the oldest of the same thing drop out.

    Args:
        windows: of length w.
        thing: what each episode practised, int32 [E].
        success: [E] bool.
        valid: [E] bool; the others are left out.
    """
    things, length = windows.successes.shape
    same = (thing[:, None] == thing) & valid  # [E, E]
    earlier = jnp.sum(jnp.tril(same, -1), axis=1, dtype=jnp.int32)
    later = jnp.sum(jnp.triu(same, 1), axis=1, dtype=jnp.int32)
    slot = (windows.inserted[thing] + earlier) % length
    kept = valid & (later < length)  # a slot is written once
    row = jnp.where(kept, thing, things)  # outside: dropped
    return Windows(
        successes=windows.successes.at[row, slot].set(success.astype(jnp.float32), mode="drop"),
        inserted=windows.inserted.at[thing].add(valid.astype(jnp.int32)),
    )


def progress(windows: Windows) -> Float[Array, " things"]:
    """Change of each thing's success rate, [things] in [-1, 1]; 0 before its second episode.

    Of k episodes in the window, the latest k // 2 are compared with as many before them.
    """
    age, half = _ages(windows), _filled(windows) // 2
    newer = age < half[:, None]
    older = (age < 2 * half[:, None]) & ~newer
    gained = jnp.sum(jnp.where(newer, windows.successes, 0.0), axis=1)
    had = jnp.sum(jnp.where(older, windows.successes, 0.0), axis=1)
    return (gained - had) / jnp.maximum(half, 1).astype(gained.dtype)


def window_rates(windows: Windows, default: ArrayLike) -> Float[Array, " things"]:
    """Success rate of each thing over its window, [things]; `default` before its first episode."""
    filled = _filled(windows)
    seen = _ages(windows) < filled[:, None]
    total = jnp.sum(jnp.where(seen, windows.successes, 0.0), axis=1)
    return jnp.where(filled > 0, total / jnp.maximum(filled, 1).astype(total.dtype), default)


def _filled(windows: Windows) -> jax.Array:
    return jnp.minimum(windows.inserted, windows.successes.shape[1])


def _ages(windows: Windows) -> jax.Array:
    """How many episodes each slot is behind the latest of its thing, [things, w]."""
    length = windows.successes.shape[1]
    return (windows.inserted[:, None] - 1 - jnp.arange(length)) % length
