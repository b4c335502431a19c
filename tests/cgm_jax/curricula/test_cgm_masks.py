"""The masks that CGM draws: from a table up to ten dimensions, without one beyond."""

import itertools
import json
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from cgm_jax import train
from cgm_jax.config.fields import SettingError
from cgm_jax.curricula.cgm import CGM, CGMState
from cgm_jax.curricula.parts.history import SuccessHistory
from cgm_jax.curricula.parts.masks import goal_masks
from cgm_jax.curricula.protocol import Goals, View
from tests.cgm_jax.curricula.small import sizes

VIEW = View(None, jnp.zeros(()), jnp.zeros(()), lambda *_: jnp.zeros(1), lambda *_: jnp.zeros(1))
SLIDERS = Path(__file__).parents[3] / "experiments/learning/sliders.py"


def state_with(rates: np.ndarray) -> CGMState:
    """After ten evaluation episodes with these success rates, in tenths, of the sub-goals."""
    successes = np.arange(10)[:, None] < np.round(10 * rates)
    return CGMState(SuccessHistory(jnp.asarray(successes, jnp.float32), jnp.asarray(10)))


def sampled(curriculum: CGM, rates: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Masks drawn [count, n], and their success rates [count] by the definition."""
    drawn = Goals(jnp.zeros((count, len(rates))), jnp.ones((count, len(rates))), jnp.ones(count))
    sample = jax.jit(lambda state, key: curriculum.sample(state, key, drawn, VIEW).mask)
    masks = np.asarray(sample(state_with(rates), jax.random.key(0)))
    return masks, np.prod(np.where(masks > 0, rates, 1.0), axis=1)


def test_up_to_ten_dimensions_masks_are_drawn_from_the_papers_table() -> None:
    curriculum, rates = CGM(c_g=0.4, kappa=4.0, full_share=0.2), np.array([0.8, 0.5, 0.3])
    masks, _ = sampled(curriculum, rates, 256)
    table = np.array(list(itertools.product([0, 1], repeat=3)))
    weights = (1 - np.abs(np.prod(np.where(table > 0, rates, 1.0), axis=1) - 0.4)) ** 4
    probabilities = 0.8 * weights / weights.sum() + 0.2 * (np.arange(8) == 7)
    reported = curriculum.report(state_with(rates))["mask_probability"]
    np.testing.assert_allclose(reported, probabilities, rtol=1e-5)
    indices = jax.random.categorical(jax.random.key(0), jnp.log(reported), shape=(256,))
    np.testing.assert_array_equal(masks, goal_masks(3)[indices])


def test_with_levels_a_difficulty_counts_once_however_many_masks_have_it() -> None:
    # Two masks always succeed, four half of the time, and two in one of four episodes.
    rates = np.array([0.5, 1.0, 0.5])
    curriculum = CGM(c_g=0.5, kappa=2.0, mask_levels=True)
    report = curriculum.report(state_with(rates))
    estimates = [1, 0.5, 1, 0.5, 0.5, 0.25, 0.5, 0.25]
    np.testing.assert_allclose(report["mask_rate_estimated"], estimates)
    always, half, quarter = np.array([0.5, 1.0, 0.75]) ** 2 / (0.25 + 1 + 0.5625)
    of_rate = {1.0: always / 2, 0.5: half / 4, 0.25: quarter / 2}
    expected = [of_rate[rate] for rate in estimates]
    np.testing.assert_allclose(report["mask_probability"], expected, rtol=1e-5)


def test_beyond_a_table_levels_reach_the_aim_that_the_papers_rule_misses() -> None:
    rates = np.full(30, 0.5)
    near = {}
    for mask_levels in (False, True):
        curriculum = CGM(c_g=0.1, kappa=32.0, mask_levels=mask_levels)
        _, estimates = sampled(curriculum, rates, 1000)
        near[mask_levels] = np.mean((estimates >= 0.05) & (estimates <= 0.2))
        report = jax.jit(curriculum.report)(state_with(rates))
        # Masks keep k dimensions at a success rate of 2^-k.
        shares = np.bincount(np.round(20 * estimates).astype(int), minlength=21) / 1000
        np.testing.assert_allclose(report["level_probability"], shares, atol=0.07)
        assert float(report["level_probability"].sum()) == pytest.approx(1.0)
        kept = np.asarray(report["level_kept_dimensions"])
        some = np.asarray(report["level_probability"]) > 0
        assert np.isfinite(kept[some]).all()
        assert np.isnan(kept[~some]).all()
    assert near[False] < 0.01
    assert near[True] > 0.5


@pytest.mark.parametrize("mask_levels", [False, True])
def test_beyond_a_table_a_share_of_full_goals_is_forced(mask_levels: bool) -> None:
    curriculum = CGM(c_g=0.1, kappa=32.0, full_share=0.25, mask_levels=mask_levels)
    masks, _ = sampled(curriculum, np.full(20, 0.5), 1000)
    assert masks.all(axis=1).mean() == pytest.approx(0.25, abs=0.055)  # four standard errors


def test_beyond_a_table_nothing_is_kept_per_mask_and_what_needs_that_is_refused() -> None:
    assert CGM().init(sizes(20)).masks is None
    for curriculum, name in (
        (CGM(factorised=False), "factorised"),
        (CGM(masked_evaluation_episodes=1), "masked_evaluation_episodes"),
    ):
        assert curriculum.init(sizes(10)).subgoals.successes.shape == (10, 10)
        with pytest.raises(
            SettingError, match=f"^{name}: .* needs a table .* 10 dimensions, not 11"
        ):
            curriculum.init(sizes(11))
    with pytest.raises(SettingError, match=r"^mask_levels: goals of 121 dimensions"):
        CGM(mask_levels=True).init(sizes(121))


@pytest.mark.slow
def test_goals_of_twenty_dimensions_train_by_the_command_line(tmp_path: Path) -> None:
    options = ["--preset", "smoke", "--env", f"{SLIDERS}:Sliders", "--mask-levels", "on"]
    assert train.main([*options, "--out", str(tmp_path / "out")]) == 0
    rows = [json.loads(line) for line in (tmp_path / "out/metrics.jsonl").read_text().splitlines()]
    assert [row["epoch"] for row in rows] == [1, 2]
    for row in rows:
        assert len(row["subgoal_success"]) == 20
        assert sum(row["level_probability"]) == pytest.approx(1.0, abs=1e-5)
        assert len(row["level_kept_dimensions"]) == 21
        assert row["level"] == pytest.approx([i / 20 for i in range(21)])
        for name in ("mask_rate_estimated", "mask_rate_training", "mask_probability", "mask_share"):
            assert row[name] is None
    drawn = {path.name for path in (tmp_path / "out/figures").iterdir()}
    assert drawn == {"learning_curves.png", "curriculum.png"}
