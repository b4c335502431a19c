import dataclasses
import math

import pytest

from experiments.learning.tables import env_steps_to_hold, learning_speed, window_means
from tests.experiments.learning.recorded import run


def test_a_level_is_held_by_three_evaluations_and_not_by_one() -> None:
    assert env_steps_to_hold(run([0.9, 0.2, 0.3, 0.4, 0.8]), 0.5) == 5000
    assert env_steps_to_hold(run([0.9, None, 0.4, 0.4]), 0.5) == math.inf


def test_learning_speed_shows_every_seed_and_interpolated_quartiles() -> None:
    runs = [
        run([0.0, 0.0, 0.6, 0.6, 0.6, 0.6], seed=3),
        run([0.5, 0.5, 0.5, 0.9, 0.9, 0.9], seed=0),
        run([0.0, 0.0, 0.0, 0.0, 0.3, 0.3], seed=1),
        run([0.0, 0.4, 0.5, 0.6, 0.6, 0.6], seed=2),
    ]
    (entry,) = learning_speed(runs)
    assert entry["seeds"] == "0 1 2 3"
    assert (entry["held_by_50"], entry["env_steps_to_50"]) == (3, "3000 - 4000 5000")
    assert entry["wall_s_to_50"] == "6 - 8 10"
    # Of 3, 4, 5 thousand and never: a quarter on from 3 towards 4; the median between 4 and 5.
    assert (entry["low_quartile_to_50"], entry["median_to_50"]) == ("3750", "4500")
    assert entry["high_quartile_to_50"] == "-"
    assert (entry["held_by_90"], entry["env_steps_to_90"]) == (1, "6000 - - -")
    assert entry["final_success"] == "0.9 0.2 0.6 0.6"


def test_seconds_of_runs_side_by_side_and_levels_beyond_the_end_are_left_out() -> None:
    left = run([0.6, 0.6, 0.6], leave_at=0.5, epochs=9)
    together = dataclasses.replace(left, alone=False)
    (entry,) = learning_speed([together])
    assert (entry["env_steps_to_50"], entry["wall_s_to_50"]) == ("3000", "")
    assert (entry["env_steps_to_90"], entry["final_success"]) == ("", "left")
    assert left.budget == 9000


def test_quartiles_that_a_longer_training_might_have_changed_are_not_known() -> None:
    short, late = run([0.0] * 5, 0), [0.0] * 4 + [0.6] * 5
    (entry,) = learning_speed([short, *(run([0.6] * 9, seed) for seed in (1, 2, 3)), run(late, 4)])
    assert entry["env_steps_to_50"] == "- 3000 3000 3000 7000"
    # The short one might have held it at 6,000: 3, 3, 3, 6, 7; or never.
    assert [entry[f"{name}_to_50"] for name in ("low_quartile", "median", "high_quartile")] == [
        *("3000", "3000", "?")
    ]
    (entry,) = learning_speed([short, run([0.6] * 9, 1)])  # at 3,000, while both trained
    assert (entry["env_steps_to_50"], entry["median_to_50"]) == ("- 3000", "-")


def test_runs_that_share_setting_and_seed_are_not_taken_for_one() -> None:
    with pytest.raises(ValueError, match="the same run"):
        learning_speed([run([0.5]), run([0.5], sweep="other")])


def test_runs_of_a_setting_that_differ_in_what_no_table_says_are_not_pooled() -> None:
    pooled = [run([0.5]), run([0.5], 1, "more", epochs=9, leave_at=0.5)]
    assert [entry["seeds"] for entry in learning_speed(pooled)] == ["0 1"]
    with pytest.raises(ValueError, match="more and one differ in batch_size"):
        learning_speed([run([0.5]), run([0.5], 1, "more", batch_size=64)])


def test_settings_keep_their_order_and_their_seeds() -> None:
    table = learning_speed([run([0.1], curriculum="full", seed=1), run([0.1]), run([0.1], seed=1)])
    assert [(entry["masks"], entry["seeds"]) for entry in table] == [
        ("no masks", "1"),
        ("CGM", "0 1"),
    ]


def test_means_of_windows_leave_out_what_is_unknown() -> None:
    runs = [run([0.1, 0.3, None, None, 0.5])]
    means = window_means(runs, [2000, 4000, 6000], "success_rate")
    assert means[2000] == pytest.approx(0.2)
    assert math.isnan(means[4000])
    assert means[6000] == 0.5
    for row in runs[0].rows:
        row["mask_probability"] = [0.75, 0.25] if row["epoch"] < 3 else []
    by_mask = window_means(runs, [2000, 5000], "mask_probability", 1)
    assert by_mask[2000] == 0.25
    assert math.isnan(by_mask[5000])
