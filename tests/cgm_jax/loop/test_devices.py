import jax
import numpy as np
import pytest

from cgm_jax.loop.devices import Share, mesh_of, share, spread


@pytest.mark.parametrize(
    ("runs", "devices", "expected"),
    [
        (8, 2, Share(2, 4)),
        (3, 2, Share(2, 2)),  # one row more than there are runs
        (3, 8, Share(3, 1)),  # no device without a run
        (9, 8, Share(5, 2)),  # as long as on eight devices, and one row too many in place of seven
        (1, 4, Share(1, 1)),
        (5, 1, Share(1, 5)),
    ],
)
def test_runs_are_shared_out(runs: int, devices: int, expected: Share) -> None:
    assert share(runs, devices) == expected


def test_what_is_spread_keeps_its_bits() -> None:
    key = jax.random.split(jax.random.key(0), 3)
    numbers, keys = spread(mesh_of(jax.devices()[:1]), (np.arange(3.0), key))
    np.testing.assert_array_equal(numbers, [0.0, 1.0, 2.0])
    np.testing.assert_array_equal(jax.random.key_data(keys), jax.random.key_data(key))
