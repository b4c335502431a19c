"""Rows one after another."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from cgm_jax.loop.in_turn import in_place, in_turn


@pytest.mark.parametrize("rows", [1, 3])
@pytest.mark.parametrize("count", [0, 1])
def test_a_function_is_called_for_the_first_rows_alone(rows: int, count: int) -> None:
    called = []

    def on_host(x: np.ndarray) -> np.ndarray:
        called.append(float(x))
        return x * 2

    def doubled(x: jax.Array) -> jax.Array:
        return jax.pure_callback(on_host, jax.ShapeDtypeStruct((), jnp.float32), x)

    values = 5.0 + jnp.arange(rows, dtype=jnp.float32)
    found = jax.jit(lambda count: in_turn(doubled, count)(values))(count)
    assert found[:count].tolist() == [10.0] * count
    assert called == [5.0] * count
    found = jax.jit(lambda count: in_place(lambda x, _: doubled(x), count)(values, values))(count)
    np.testing.assert_array_equal(found, values.at[:count].multiply(2))
    assert called == [5.0] * 2 * count
