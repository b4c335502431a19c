from collections import deque

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from cgm_jax.curricula.parts.recent import init_recent, mean_of, record

pytestmark = pytest.mark.usefixtures("strict")


def test_a_ring_holds_the_last_valid_rows_as_a_deque_does() -> None:
    rng = np.random.default_rng(0)
    ring, oracle = init_recent(jnp.zeros(()), 5), deque(maxlen=5)
    step = jax.jit(record)
    for share in (0.2, 0.3, 0.9, 0.2, 1.0, 0.5):  # also of more than it holds
        rows, valid = rng.normal(size=8).astype(np.float32), rng.random(8) < share
        ring = step(ring, jnp.asarray(rows), jnp.asarray(valid))
        oracle.extend(rows[valid])
        held = np.asarray(ring.rows)[np.asarray(ring.filled)]
        np.testing.assert_array_equal(np.sort(held), np.sort(oracle))
        np.testing.assert_allclose(mean_of(ring, ring.rows), np.mean(oracle), rtol=1e-6)


def test_rows_without_a_valid_one_change_no_bit() -> None:
    ring = record(init_recent(jnp.zeros(2), 3), jnp.ones((2, 2)), jnp.ones(2, bool))
    again = record(ring, jnp.full((2, 2), jnp.nan), jnp.zeros(2, bool))
    np.testing.assert_array_equal(again.rows, ring.rows)
    assert again.recorded == ring.recorded == 2


def test_keys_and_raw_bits_survive_the_ring() -> None:
    nan_bits = jnp.array([0x7FC00001, 0xFFFFFFFF], jnp.uint32)  # would not survive as floats
    like = jax.eval_shape(lambda: {"key": jax.random.key(0), "bits": nan_bits})
    rows = {"key": jax.random.split(jax.random.key(3), 2), "bits": jnp.stack([nan_bits, nan_bits])}
    ring = record(init_recent(like, 4), rows, jnp.array([False, True]))
    np.testing.assert_array_equal(ring.rows["bits"][0], nan_bits)
    kept, given = jax.random.key_data(ring.rows["key"])[0], jax.random.key_data(rows["key"])[1]
    np.testing.assert_array_equal(kept, given)


def test_the_mean_of_nothing_is_unknown() -> None:
    assert np.isnan(mean_of(init_recent(jnp.zeros(()), 3), jnp.ones(3)))
