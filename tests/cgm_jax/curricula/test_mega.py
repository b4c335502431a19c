from collections import deque

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from cgm_jax.curricula.mega import MEGA, MEGAState, Memo, rarest_reachable
from cgm_jax.curricula.parts.density import log_density, log_density_of_others
from tests.cgm_jax.curricula.line import (
    SIZES,
    Line,
    compiled_sample,
    drawn_goals,
    outcomes,
    same_bits,
    view,
    walk,
)


def oracle_density(points: np.ndarray, samples: np.ndarray, bandwidth: float) -> np.ndarray:
    """Mean of the normal densities around all samples, in float64 and by the definition."""
    squares = ((points[:, None] - samples[None]).astype(np.float64) ** 2).sum(axis=-1)
    scale = (bandwidth * np.sqrt(2 * np.pi)) ** points.shape[1]
    return (np.exp(-0.5 * squares / bandwidth**2) / scale).mean(axis=1)


@pytest.mark.parametrize("bandwidth", [0.1, 1.0])
def test_densities_are_means_of_normal_densities(bandwidth: float) -> None:
    points, samples = np.random.default_rng(0).normal(size=(2, 30, 3)).astype(np.float32)
    ours = log_density(jnp.asarray(points), jnp.asarray(samples), bandwidth)
    expected = oracle_density(points, samples, bandwidth)
    seen = expected > 1e-30
    np.testing.assert_allclose(ours[seen], np.log(expected[seen]), rtol=1e-3, atol=1e-3)
    assert np.isfinite(ours).all()


def test_the_density_of_others_leaves_out_each_samples_own_kernel() -> None:
    samples = np.random.default_rng(0).normal(size=(40, 2)).astype(np.float32)
    ours = log_density_of_others(jnp.asarray(samples), 0.5)
    for i, sample in enumerate(samples):
        (expected,) = oracle_density(sample[None], np.delete(samples, i, axis=0), 0.5)
        np.testing.assert_allclose(ours[i], np.log(expected), rtol=1e-3, atol=1e-3)


def test_the_rarest_goal_within_reach_is_chosen_and_else_the_most_promising() -> None:
    density = jnp.array([[-9.0, -5.0, -1.0]] * 3)
    values = jnp.array([[-8.0, -2.0, -1.0], [-1.0, -1.0, -1.0], [-8.0, -6.0, -4.0]])
    np.testing.assert_array_equal(rarest_reachable(density, values, -3.0), [1, 0, 2])


def test_the_cutoff_starts_at_its_setting_but_no_lower_than_an_episode_reaches() -> None:
    np.testing.assert_allclose(MEGA().init(SIZES).cutoff, -3.0)
    floor = -(1 - 0.98**40) / 0.02
    np.testing.assert_allclose(MEGA().init(SIZES).floor, floor, rtol=1e-5)
    short = SIZES._replace(episode_length=2)
    np.testing.assert_allclose(MEGA().init(short).cutoff, -(1 - 0.98**1.6) / 0.02, rtol=1e-4)


def test_the_cutoff_follows_success_as_in_mrl() -> None:
    rng, curriculum = np.random.default_rng(1), MEGA()
    floor = -(1 - 0.98**40) / 0.02
    cutoff, lower, last = -3.0, -3.0, deque(maxlen=10)
    state, seen = curriculum.init(SIZES), []
    step = jax.jit(curriculum.after_training)
    for cycle in range(150):
        rate = 0.9 if cycle < 80 else 0.15
        success, lowest = rng.random(4) < rate, float(rng.uniform(-40, 0))
        goals = drawn_goals(np.zeros((4, 2))).replace(
            memo=Memo(jnp.asarray(0.5), jnp.asarray(lowest))
        )
        state = step(state, outcomes(goals, success))
        last.extend(success)
        if len(last) == 10:
            lower = max(floor, min(lowest, lower))
            if np.mean(last) >= 0.7:
                cutoff = max(lower, cutoff - 1.0)
                last.clear()
            elif np.mean(last) <= 0.3:
                cutoff = max(min(-3.0, cutoff + 1.0), floor)
                last.clear()
        seen.append(cutoff)
        np.testing.assert_allclose(state.cutoff, cutoff, rtol=1e-5)
        np.testing.assert_allclose(state.lower, lower, rtol=1e-5)
    assert min(seen) < -20.0
    assert seen[-1] > min(seen) + 5.0


def test_episodes_with_broken_physics_change_nothing() -> None:
    state = MEGA().init(SIZES)
    goals = drawn_goals(np.zeros((20, 2))).replace(memo=Memo(jnp.asarray(1.0), jnp.asarray(-9.0)))
    broken = outcomes(goals, np.ones(20), np.zeros(20, bool))
    assert same_bits(MEGA().after_training(state, broken), state)


@pytest.mark.parametrize(("filled", "cutoff"), [(0, -3.0), (50, -4.0)])
def test_the_cutoff_does_not_follow_goals_of_an_empty_replay(filled: int, cutoff: float) -> None:
    # All episodes succeed, and all values are -9: the cutoff falls by 1 if a candidate says so.
    curriculum = MEGA(density_samples=10)
    seen = view(
        np.zeros((50, 5, 2)),
        filled,
        np.zeros((20, 2)),
        value=lambda _, goal: jnp.full((1, *goal.shape[:-1]), -9.0),
        draw=lambda key, count: jax.random.uniform(key, (count, 2)),
    )
    state = curriculum.init(SIZES)
    goals = compiled_sample(
        curriculum, state, jax.random.key(0), drawn_goals(np.ones((20, 2))), seen
    )
    after = curriculum.after_training(state, outcomes(goals, np.ones(20)))
    assert (float(after.lower), float(after.cutoff)) == (-9.0 if filled else -3.0, cutoff)


def sampled(state: MEGAState, drawn_value: float, bonus: float) -> tuple[np.ndarray, Memo]:
    """Goals of 64 episodes: replay achieved normal goals, the environment's are uniform in 0..1."""
    achieved = np.random.default_rng(0).normal(size=(50, 5, 2))
    curriculum = MEGA(omega_bonus=bonus, density_samples=300)
    drawn = drawn_goals(np.full((64, 2), 0.5))
    goals = compiled_sample(
        curriculum,
        state,
        jax.random.key(0),
        drawn,
        view(
            achieved,
            50,
            np.zeros((64, 2)),
            value=lambda _, goal: jnp.where((goal == 0.5).all(-1), drawn_value, -1.0)[None],
            draw=lambda key, count: jax.random.uniform(key, (count, 2)),
        ),
    )
    return np.asarray(goals.desired), goals.memo


def test_omega_keeps_the_environments_goals_with_probability_alpha_if_they_can_be_reached() -> None:
    state = MEGA().init(SIZES)
    goals, memo = sampled(state, -1.0, bonus=-3.0)
    assert memo.alpha == 1.0  # achieved goals cover them: KL is below 4
    assert (goals == 0.5).all()
    goals, memo = sampled(state, -1.0, bonus=4.0)
    assert 0.1 < memo.alpha < 0.3  # 1 / (4 + KL), KL of about 1.5
    np.testing.assert_allclose((goals == 0.5).all(axis=1).mean(), memo.alpha, atol=0.15)
    goals, _ = sampled(state, -5.0, bonus=-3.0)
    assert not (goals == 0.5).all(axis=1).any()
    assert np.median(np.linalg.norm(goals, axis=1)) > 2.0  # of 100, the outermost


def alpha(target: np.ndarray, achieved: np.ndarray, bonus: float) -> float:
    """OMEGA's alpha where the environment draws `target` and replay achieved `achieved`, [m, n]."""
    count, size = target.shape
    curriculum = MEGA(density_samples=count, omega_bonus=bonus)
    goals = compiled_sample(
        curriculum,
        curriculum.init(SIZES._replace(goal=size)),
        jax.random.key(0),
        drawn_goals(np.zeros((4, size))),
        view(
            achieved[:, None],
            len(achieved),
            np.zeros((4, size)),
            value=lambda _, goal: goal[None, ..., 0] * 0.0,
            draw=lambda *_: jnp.asarray(target, jnp.float32),
        ),
    )
    return float(goals.memo.alpha)


def test_alpha_is_one_over_the_divergence_of_the_two_distributions() -> None:
    rng = np.random.default_rng(0)
    achieved, target = rng.normal(0.0, 2.0, size=(2000, 1)), rng.normal(size=(2000, 1))
    # Of normal distributions, to which densities with a bandwidth of 0.1 come near.
    divergence = np.log(2.0) + 1 / 8 - 1 / 2
    np.testing.assert_allclose(1 / alpha(target, achieved, bonus=2.0), 2.0 + divergence, rtol=0.02)


@pytest.mark.parametrize("size", [3, 4])
def test_alpha_is_one_where_the_environments_goals_are_what_is_achieved(size: int) -> None:
    achieved, target = np.random.default_rng(size).normal(size=(2, 1000, size))
    assert alpha(target, achieved, bonus=-3.0) == 1.0


@pytest.mark.slow
def test_training_practises_the_frontier() -> None:
    ours, full = (walk(name, Line(), 60)[1].replay.episodes for name in ("mega", "full"))
    achieved = np.abs(np.asarray(ours.achieved_goal))
    goals = np.abs(np.asarray(ours.desired_goal))[-480:, 0]
    assert np.median(goals) > np.quantile(achieved, 0.95)
    assert (goals <= achieved.max()).mean() > 0.97  # and yet they were achieved before
    assert (np.abs(np.asarray(full.desired_goal)) <= achieved.max()).mean() < 0.7


def test_a_dimension_that_never_varied_does_not_hide_which_goals_are_rare() -> None:
    achieved = np.random.default_rng(0).normal(size=(50, 5, 2))
    achieved[..., 1] = 0.5  # as the height of a block that nobody has lifted
    curriculum = MEGA(omega_bonus=1e6, density_samples=100)  # alpha is 0
    goals = compiled_sample(
        curriculum,
        curriculum.init(SIZES),
        jax.random.key(0),
        drawn_goals(np.full((64, 2), 0.5)),
        view(
            achieved,
            50,
            np.zeros((64, 2)),
            value=lambda _, goal: jnp.full((1, *goal.shape[:-1]), -1.0),
            draw=lambda key, count: jax.random.uniform(key, (count, 2)),
        ),
    )
    assert np.isfinite(goals.memo.alpha)
    assert np.median(np.abs(goals.desired[:, 0])) > 1.8  # of 100, the outermost


def test_what_can_be_reached_is_told_by_the_mean_over_critics() -> None:
    # Replay has been at x = 0, 1, 2, ever more rarely; two critics say -1, and -1, -3, -7.
    achieved = np.stack([np.repeat([0.0, 1.0, 2.0], [20, 8, 4]), np.zeros(32)], axis=1)[None]

    def value(_: jax.Array, goal: jax.Array) -> jax.Array:
        x = goal[..., 0]
        return jnp.stack([-jnp.ones_like(x), 1.0 - jnp.exp2(x + 1.0)])

    curriculum = MEGA(omega_bonus=-1e3, density_samples=50)  # alpha is 1; the cutoff is -3
    seen = view(achieved, 1, np.zeros((32, 2)), value, lambda _, count: jnp.zeros((count, 2)))
    drawn = drawn_goals(np.tile([2.0, 0.0], (32, 1)))  # -4 in the mean
    goals = compiled_sample(curriculum, curriculum.init(SIZES), jax.random.key(0), drawn, seen)
    np.testing.assert_array_equal(goals.desired[:, 0], 1.0)


def test_the_floor_reckons_with_a_discount_of_at_most_99_percent() -> None:
    floor = MEGA(discount=0.999).init(SIZES).floor
    np.testing.assert_allclose(floor, -(1 - 0.99**40) / 0.01, rtol=1e-4)
