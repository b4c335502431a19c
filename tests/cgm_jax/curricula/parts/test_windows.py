import jax
import jax.numpy as jnp
import numpy as np
import pytest

from cgm_jax.curricula.parts.windows import init_windows, progress, record_episodes, window_rates

pytestmark = pytest.mark.usefixtures("strict")

record = jax.jit(record_episodes)


@pytest.mark.parametrize("length", [2, 5, 40])
def test_windows_hold_the_latest_episodes_of_each_thing(length: int) -> None:
    generator = np.random.default_rng(length)
    windows, kept = init_windows(3, length), [[], [], []]
    for _ in range(20):
        thing = generator.choice(3, 8, p=[0.7, 0.25, 0.05])
        success, valid = generator.integers(0, 2, (2, 8)).astype(bool)
        windows = record(windows, thing.astype(np.int32), success, valid)
        for i in range(8):
            if valid[i]:
                kept[thing[i]].append(float(success[i]))
        latest = [episodes[-length:] for episodes in kept]
        rates = [np.mean(episodes) if episodes else 0.25 for episodes in latest]
        np.testing.assert_allclose(window_rates(windows, 0.25), np.array(rates), atol=1e-6)
        changes = []
        for episodes in latest:
            half = len(episodes) // 2
            newer, older = episodes[len(episodes) - half :], episodes[-2 * half : -half]
            changes.append(np.mean(newer) - np.mean(older) if half else 0.0)
        np.testing.assert_allclose(progress(windows), changes, atol=1e-6)
    assert len(kept[0]) > 40 > len(kept[2])


def test_progress_by_hand() -> None:
    # Of 0 0 1 0 1 1 1 a window of six holds 0 1 0 | 1 1 1: from 1/3 to 3/3.
    success = jnp.array([0, 0, 1, 0, 1, 1, 1], bool)
    windows = record(init_windows(2, 6), jnp.ones(7, jnp.int32), success, jnp.ones(7, bool))
    np.testing.assert_allclose(progress(windows), [0, 2 / 3], atol=1e-6)
    np.testing.assert_array_equal(windows.inserted, [0, 7])


def test_invalid_episodes_change_nothing() -> None:
    windows = record(init_windows(2, 3), jnp.arange(2), jnp.ones(2, bool), jnp.ones(2, bool))
    after = record(windows, jnp.arange(2), jnp.zeros(2, bool), jnp.zeros(2, bool))
    jax.tree.map(np.testing.assert_array_equal, windows, after)
