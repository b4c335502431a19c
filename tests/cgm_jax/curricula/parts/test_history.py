import jax.numpy as jnp
import numpy as np
import pytest

from cgm_jax.curricula.parts.history import init_history, record_successes, subgoal_rates
from cgm_jax.curricula.parts.masks import goal_masks, mask_success_rates

pytestmark = pytest.mark.usefixtures("strict")


@pytest.mark.parametrize("c_g", [0.0, 0.1, 0.8, 1.0])
@pytest.mark.parametrize("n", [1, 3, 12])
def test_before_any_evaluation_the_full_goal_is_estimated_at_c_g(c_g: float, n: int) -> None:
    rates = subgoal_rates(init_history(10, n), c_g)
    full_goal = mask_success_rates(goal_masks(n), rates)[-1]
    assert float(full_goal) == pytest.approx(c_g, abs=1e-6)


def test_history_matches_a_list_of_the_last_h_valid_rollouts() -> None:
    generator = np.random.default_rng(0)
    history, record = init_history(10, 3), []
    for count in (3, 4, 7, 25, 1):
        successes = generator.integers(0, 2, (count, 3))
        valid = generator.random(count) < 0.7
        history = record_successes(history, jnp.asarray(successes), jnp.asarray(valid))
        record += [row for row, ok in zip(successes, valid, strict=True) if ok]
        np.testing.assert_allclose(
            subgoal_rates(history, 0.1), np.mean(record[-10:], axis=0), rtol=1e-6
        )


def test_history_of_only_broken_rollouts_keeps_the_default() -> None:
    history = record_successes(init_history(10, 2), jnp.ones((4, 2)), jnp.zeros(4, bool))
    np.testing.assert_allclose(subgoal_rates(history, 0.25), [0.5, 0.5])
