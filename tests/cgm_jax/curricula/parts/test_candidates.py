import jax
import jax.numpy as jnp
import numpy as np
import pytest

from cgm_jax.curricula.parts.candidates import achieved_goals, draw_eligible, nearest_success
from tests.cgm_jax.curricula.line import view

pytestmark = pytest.mark.usefixtures("strict")


def test_success_is_the_mean_over_the_nearest_that_were_practised() -> None:
    rng = np.random.default_rng(0)
    points, practised = (rng.normal(size=(m, 3)).astype(np.float32) for m in (20, 40))
    success, filled = rng.random(40) < 0.5, np.arange(40) < 25
    known = jnp.asarray(practised), jnp.asarray(success), jnp.asarray(filled)
    estimates = nearest_success(jnp.asarray(points), *known, 7)
    for point, estimate in zip(points, estimates, strict=True):
        distance = np.linalg.norm(practised[:25] - point, axis=1)
        np.testing.assert_allclose(estimate, success[np.argsort(distance)[:7]].mean(), rtol=1e-6)


def test_fewer_than_the_neighbours_are_all_averaged_and_none_is_unknown() -> None:
    practised, success = jnp.array([[0.0], [9.0], [5.0]]), jnp.array([True, False, True])
    few = nearest_success(jnp.ones((1, 1)), practised, success, jnp.arange(3) < 2, 10)
    np.testing.assert_allclose(few, [0.5])
    none = nearest_success(jnp.ones((1, 1)), practised, success, jnp.zeros(3, bool), 10)
    assert np.isnan(none).all()


def test_candidates_are_uniform_over_the_real_episodes_of_replay() -> None:
    achieved = np.arange(12.0).reshape(4, 3, 1)  # four episodes of three goals; two are real
    goals = achieved_goals(jax.random.key(0), view(achieved, 2, np.zeros((1, 2))), (6000,))
    counts = np.bincount(np.asarray(goals[:, 0], int), minlength=12)
    assert counts[6:].sum() == 0
    np.testing.assert_allclose(counts[:6] / 6000, 1 / 6, atol=0.02)


def test_candidates_are_none_of_the_copies_after_an_early_end() -> None:
    # Of four steps the episodes took one, none, four and two; the fourth is not real.
    achieved = np.repeat(np.arange(20.0).reshape(4, 5, 1), 2, axis=2)
    seen = view(achieved, 3, np.zeros((1, 2)))._replace(steps=jnp.array([1, 0, 4, 2], jnp.int32))
    goals = np.asarray(achieved_goals(jax.random.key(0), seen, (300, 20)))
    assert goals.shape == (300, 20, 2)
    shares = np.bincount(goals[..., 0].astype(int).reshape(-1), minlength=20) / 6000
    expected = np.zeros(20)
    expected[[0, 1]], expected[5], expected[10:15] = 1 / 6, 1 / 3, 1 / 15
    np.testing.assert_allclose(shares, expected, atol=0.025)
    np.testing.assert_array_equal(shares > 0, expected > 0)


def test_draws_are_uniform_among_the_eligible_or_else_among_all() -> None:
    some = draw_eligible(jax.random.key(0), jnp.array([False, True, False, True]), 4000)
    np.testing.assert_allclose(np.bincount(some, minlength=4) / 4000, [0, 0.5, 0, 0.5], atol=0.03)
    none = draw_eligible(jax.random.key(0), jnp.zeros(4, bool), 4000)
    np.testing.assert_allclose(np.bincount(none, minlength=4) / 4000, 0.25, atol=0.03)
