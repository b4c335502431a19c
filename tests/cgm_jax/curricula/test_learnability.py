import itertools

import jax.numpy as jnp
import numpy as np
import pytest

from cgm_jax.config.fields import SettingError
from cgm_jax.curricula.learnability import Learnability, learnable
from cgm_jax.curricula.parts.history import init_history, record_successes
from tests.cgm_jax.curricula.small import Chances, epochs, sizes
from tests.cgm_jax.probe import tiny


def after(successes: list[list[int]]) -> dict[str, np.ndarray]:
    """What is reported after evaluation episodes with these sub-goals achieved."""
    history = init_history(10, len(successes[0]))
    history = record_successes(history, jnp.array(successes), jnp.ones(len(successes), bool))
    return {name: np.asarray(x) for name, x in Learnability().report(history).items()}


def test_masks_are_weighed_by_the_variance_of_their_success() -> None:
    # Sub-goals succeed in 1/2, 4/4 and 1/4 of the episodes.
    report = after([[1, 1, 0], [0, 1, 0], [1, 1, 1], [0, 1, 0]])
    rates = [1, 1 / 4, 1, 1 / 4, 1 / 2, 1 / 8, 1 / 2, 1 / 8]
    np.testing.assert_allclose(report["mask_rate_estimated"], rates)
    variances = np.array([0, 12, 0, 12, 16, 7, 16, 7]) / 64
    np.testing.assert_allclose(report["mask_probability"], variances / variances.sum(), rtol=1e-6)


def test_before_any_evaluation_the_full_goal_is_the_most_learnable() -> None:
    report = Learnability().report(Learnability().init(sizes(3)))
    rates = [0.5 ** (sum(mask) / 3) for mask in itertools.product([0, 1], repeat=3)]
    np.testing.assert_allclose(report["mask_rate_estimated"], rates, rtol=1e-6)
    assert int(report["mask_probability"].argmax()) == 7


@pytest.mark.parametrize("rates", [[1.0, 0.0, 0.0, 0.0], [1.0, 1.0, 1.0, 1.0]])
def test_masks_are_uniform_where_all_always_or_never_succeed(rates: list[float]) -> None:
    np.testing.assert_array_equal(learnable(jnp.array(rates)), 0.25)


def test_a_share_of_masks_is_uniform_whatever_they_score() -> None:
    history = record_successes(init_history(10, 2), jnp.array([[1, 0], [0, 0]]), jnp.ones(2, bool))
    report = Learnability(uniform_share=0.4).report(history)
    # In order 00, 01, 10, 11: rates 1, 0, 1/2, 0, of which only the third scores.
    np.testing.assert_allclose(report["mask_probability"], [0.1, 0.1, 0.7, 0.1], rtol=1e-6)


def test_goals_beyond_a_table_are_refused() -> None:
    with pytest.raises(SettingError, match=r"curriculum: learnability needs a table .* not 11"):
        Learnability().init(sizes(11))


def test_training_practises_what_sometimes_succeeds() -> None:
    run = epochs(Chances(), tiny(curriculum="learnability", success_history=20))
    (_, first), (_, second), (_, third) = (next(run) for _ in range(3))
    assert (first["mask_share"][1:] > 0).all()
    np.testing.assert_array_equal(first["mask_share"][0], 0.0)
    # The first sub-goal always succeeds, the second never: what keeps the third alone, or with
    # the first, is all that there is to learn.
    for metrics in (second, third):
        share = metrics["mask_share"]
        assert share[1] == pytest.approx(0.5, abs=0.15)  # four standard errors
        assert share[1] + share[5] == 1.0
