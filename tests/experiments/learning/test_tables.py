from typing import Any

import numpy as np
import pytest

from experiments.learning.tables import (
    area_under_curve,
    improvement,
    learning_speed,
    probability_of_improvement,
    setting_of,
)

BASELINES: list[dict[str, Any]] = [
    *({"cgm": False}, {"kappa": 0.0}),
    *({"estimate": "joint"}, {"estimate": "measured"}),
]


def run(seed: int, rates: list[float | None], *, cgm: bool = True) -> list[dict[str, Any]]:
    """Rows of one run: an evaluation every 1,000 env_steps and 2 seconds."""
    fixed = {"env": "push", "her": True, "cgm": cgm, "c_g": 0.1, "kappa": 32.0, "seed": seed}
    fixed |= {
        "her_filter": True,
        "estimate": "product",
        "sweep": "one",
        "run": f"{cgm}{seed}",
        "alone": True,
    }
    fixed |= {"leave_at": None}
    return [
        {**fixed, "env_steps": 1000 * i, "wall_s": 2.0 * i, "success_rate": rate}
        for i, rate in enumerate(rates, start=1)
    ]


def test_learning_speed_is_the_median_of_first_arrivals() -> None:
    rows = run(0, [0.2, 0.6, 0.9]) + run(1, [0.5, 0.4, 0.7]) + run(2, [0.0, 0.1, 0.5])
    (entry,) = learning_speed(rows)
    assert entry["seeds"] == 3
    assert (entry["reach_50"], entry["env_steps_to_50"], entry["wall_s_to_50"]) == (3, 2000, 4)
    assert (entry["low_quartile_to_50"], entry["high_quartile_to_50"]) == (2000, 3000)
    assert (entry["reach_90"], entry["env_steps_to_90"]) == (1, "")  # two of three never do
    assert entry["final_success"] == pytest.approx(1.6 / 3, abs=1e-3)
    assert entry["worst_seed"] == pytest.approx(0.2)


def test_seconds_of_runs_side_by_side_and_levels_beyond_the_end_are_left_out() -> None:
    rows = [{**row, "alone": False, "leave_at": 0.5} for row in run(0, [0.2, 0.6])]
    (entry,) = learning_speed(rows)
    assert (entry["reach_50"], entry["env_steps_to_50"], entry["wall_s_to_50"]) == (1, 2000, "")
    assert (entry["reach_90"], entry["env_steps_to_90"], entry["final_success"]) == ("", "", "")


def test_runs_that_share_setting_and_seed_are_not_taken_for_one() -> None:
    twice = run(0, [0.5]) + [{**row, "sweep": "other"} for row in run(0, [0.5])]
    with pytest.raises(ValueError, match="the same run twice"):
        learning_speed(twice)


def test_settings_without_cgm_share_a_line_whatever_c_g_they_carry() -> None:
    rows = [*run(0, [0.5], cgm=False), {**run(1, [0.7], cgm=False)[0], "c_g": 0.8}]
    (entry,) = learning_speed(rows)
    assert (entry["cgm"], entry["c_g"], entry["seeds"]) == (False, None, 2)


def test_area_counts_a_missing_evaluation_as_failure_and_stops_where_told() -> None:
    assert area_under_curve(run(0, [0.5, None, 1.0]), 3000) == pytest.approx(0.5)
    assert area_under_curve(run(0, [0.5, None, 1.0]), 2000) == pytest.approx(0.25)


def test_probability_of_improvement_by_hand() -> None:
    # Of six pairs three are won, one is tied.
    probability = probability_of_improvement(np.array([1.0, 3.0]), np.array([0.0, 1.0, 4.0]))
    assert float(probability) == pytest.approx(3.5 / 6)


def test_improvement_compares_as_far_as_all_runs_got() -> None:
    with_cgm = run(0, [0.5, 0.6]) + run(1, [0.7])
    without = run(0, [0.1, 1.0], cgm=False) + run(1, [0.2, 1.0], cgm=False)
    (entry,) = improvement(with_cgm + without, resamples=200)
    assert entry["probability_of_improvement"] == 1.0  # after 1,000 env_steps
    assert (entry["low"], entry["high"]) == (1.0, 1.0)
    assert (entry["setting"], entry["baseline"]) == ("CGM (10 %, 32)", "no CGM")
    assert (entry["env_steps"], entry["seeds"], entry["baseline_seeds"]) == (1000, 2, 2)


def test_all_masks_are_compared_with_none_and_the_papers_with_the_others() -> None:
    rows = run(0, [0.5]) + run(1, [0.5])
    others = [{**row, **change, "run": str(change)} for row in rows for change in BASELINES]
    table = improvement(rows + others, resamples=200)
    names = "uniform masks", "CGM, joint rates (10 %, 32)", "CGM, masks measured (10 %, 32)"
    assert {(entry["setting"], entry["baseline"]) for entry in table} == {
        ("CGM (10 %, 32)", "no CGM"),
        *(("CGM (10 %, 32)", name) for name in names),
        *((name, "no CGM") for name in names),
    }
    assert len(table) == 7
    assert all(entry["probability_of_improvement"] == 0.5 for entry in table)


def test_uniform_masks_are_one_setting_whatever_c_g_they_carry() -> None:
    row = run(0, [0.5])[0]
    one, other = ({**row, "kappa": 0.0, "c_g": c_g} for c_g in (0.1, 0.8))
    assert setting_of(one) == setting_of(other) != setting_of(row)


def test_hindsight_from_all_episodes_is_another_algorithm_unless_there_is_none() -> None:
    row = run(0, [0.5])[0]
    one, other = ({**row, "her_filter": her_filter} for her_filter in (True, False))
    assert setting_of(one).algorithm != setting_of(other).algorithm
    assert setting_of({**one, "her": False}) == setting_of({**other, "her": False})


def test_runs_that_may_leave_early_have_no_area_to_compare() -> None:
    rows = run(0, [0.5]) + run(1, [0.5]) + run(0, [0.1], cgm=False) + run(1, [0.1], cgm=False)
    assert len(improvement(rows, resamples=200)) == 1
    assert improvement([{**row, "leave_at": 0.5} for row in rows], resamples=200) == []


def test_one_seed_proves_nothing() -> None:
    assert improvement(run(0, [0.5]) + run(0, [0.1], cgm=False)) == []
