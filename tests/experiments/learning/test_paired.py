from typing import Any

import numpy as np
import pytest

from experiments.learning.paired import (
    comparisons,
    improvement_interval,
    paired_difference,
    probability_of_improvement,
)
from experiments.learning.records import RecordedRun
from tests.experiments.learning.recorded import run


def test_a_paired_difference_by_hand() -> None:
    paired = paired_difference([11.0, 12.0, 13.0], [10.0, 10.0, 10.0])
    assert paired.differences == (1.0, 2.0, 3.0)
    assert paired.mean == pytest.approx(2.0)
    # Student's t of two degrees of freedom is 4.3027; the standard error is 1 / sqrt(3).
    assert paired.low == pytest.approx(2.0 - 4.3027 / 3**0.5, abs=1e-4)
    assert paired.high == pytest.approx(2.0 + 4.3027 / 3**0.5, abs=1e-4)
    assert paired.p_value == pytest.approx(2 / 8)  # of eight exchanges one is as large, each way


def test_seeds_trained_for_longer_are_counted_to_their_own_end() -> None:
    """Eight pairs of which five were trained to 9,000, all later without masks: p = 2 / 2^8."""
    runs = [run([0.6] * 5, seed) for seed in range(3)]
    runs += [run([0.0] * 5, seed, curriculum="full") for seed in range(3)]
    runs += [run([0.6] * 9, seed) for seed in range(3, 8)]
    late = [0.0] * 6 + [0.6] * 3
    runs += [run(late, seed, curriculum="full") for seed in range(3, 8)]
    (entry,) = comparisons(runs)
    assert entry["differences"] == "<-2000 <-2000 <-2000 -6000 -6000 -6000 -6000 -6000"
    assert (entry["p_value"], entry["probability_of_improvement"]) == (0.0078, 1.0)
    assert entry["counted_to"] == 5000


def test_an_arm_that_left_with_success_counts_as_trained_for_as_long_as_the_other() -> None:
    runs = [run([0.9] * 3, seed, leave_at=0.9, epochs=5) for seed in range(2)]
    runs += [run([0.0] * 9, seed, curriculum="full", leave_at=0.9) for seed in range(2)]
    assert {entry["differences"] for entry in comparisons(runs)} == {"<-6000 <-6000"}
    runs[1] = run([0.0] * 5, 1, leave_at=0.9)  # did not leave: of none is it known after 5,000
    assert {entry["differences"] for entry in comparisons(runs)} == {"<-2000 ?0"}


def test_the_exact_test_counts_exchanges_that_are_as_large() -> None:
    # Of 16 sums of +-1 +-2 +-3 +-4, those of at least 8: 10 and 8 alone.
    assert paired_difference([-1, 2, 3, 4], [0, 0, 0, 0]).p_value == pytest.approx(4 / 16)
    assert paired_difference([5, 5], [5, 5]).p_value == 1.0
    assert paired_difference([1.0] * 10, [0.0] * 10).p_value == pytest.approx(2 / 2**10)


def test_one_pair_has_no_interval() -> None:
    with pytest.raises(ValueError, match="two pairs"):
        paired_difference([1.0], [2.0])


def test_probability_of_improvement_by_hand() -> None:
    # Sooner is better. Of six pairs three are won, one is tied.
    probability = probability_of_improvement(np.array([1.0, 3.0]), np.array([0.0, 1.0, 4.0]))
    assert float(probability) == pytest.approx(2.5 / 6)


def test_no_bootstrap_below_ten_seeds() -> None:
    assert improvement_interval(range(9), range(9)) is None
    low, high = improvement_interval(range(10), range(5, 15)) or (1.0, 0.0)
    assert 0.5 < low < 0.875 < high <= 1.0  # of 100 pairs 85 are won, five tied


def test_arms_are_compared_by_seeds_that_both_have() -> None:
    learns = [0.0, 0.6, 0.6, 0.6, 0.6]
    later = [0.0, 0.0, 0.6, 0.6, 0.6]
    never = [0.0] * 4
    runs = [run(learns, seed) for seed in (2, 0, 1)]
    runs += [run(later, 0, curriculum="full"), run(never, 1, curriculum="full")]
    (entry,) = comparisons(runs)
    assert (entry["setting"], entry["baseline"]) == ("CGM (10 %, 32)", "no masks")
    # Held at 4,000 against 5,000, and against never, where the shorter training was 4,000.
    assert (entry["seeds"], entry["level"], entry["counted_to"]) == ("0 1", 0.5, 4000)
    assert entry["differences"] == "-1000 <0"
    (entry,) = comparisons([*runs[:4], run([0.0] * 9, 1, curriculum="full")])
    assert entry["counted_to"] == 5000  # by P(sooner)
    assert entry["differences"] == "-1000 <-1000"
    assert (entry["mean_difference"], entry["low"], entry["high"]) == ("<-1000", "", "")
    assert (entry["p_value"], entry["probability_of_improvement"]) == (0.5, 1.0)
    assert entry["improvement_low"] == ""


@pytest.mark.parametrize(
    ("other", "differences", "mean"),
    [
        ([3, 5], "1000 -1000", (0, -12706, 12706)),
        ([3, 3], "1000 1000", (1000, "", "")),  # known to one evaluation only
        ([3, None], "1000 <-5000", ("<-2000", "", "")),
        ([None, None], "<-5000 <-5000", ("<-5000", "", "")),
    ],
)
def test_the_mean_has_an_interval_where_differences_are_known_and_differ(
    other: list[int | None], differences: str, mean: tuple[Any, ...]
) -> None:
    def holding_at(epoch: int | None, seed: int, **curriculum: Any) -> RecordedRun:
        return run([0.6 if epoch and i >= epoch - 3 else 0.0 for i in range(9)], seed, **curriculum)

    runs = [holding_at(4, seed) for seed in (0, 1)]
    runs += [holding_at(epoch, seed, curriculum="full") for seed, epoch in enumerate(other)]
    (entry,) = comparisons(runs)
    assert entry["differences"] == differences
    assert (entry["mean_difference"], entry["low"], entry["high"]) == mean


def test_everything_is_compared_with_no_masks_and_with_the_papers_best_point() -> None:
    curricula = [
        {},
        {"curriculum": "full"},
        {"curriculum": "uniform"},
        {"factorised": False},
        {"c_g": 0.4},
        {"her_filter": False},  # another algorithm
    ]
    runs = [run([0.6] * 3, seed, **curriculum) for curriculum in curricula for seed in (0, 1)]
    pairs = {(entry["setting"], entry["baseline"]) for entry in comparisons(runs)}
    others = ("uniform masks", "CGM, joint rates (10 %, 32)", "CGM (40 %, 32)")
    assert pairs == {
        ("CGM (10 %, 32)", "no masks"),
        *((name, "no masks") for name in others),
        *((name, "CGM (10 %, 32)") for name in others),
    }


def test_estimates_are_compared_at_their_point_and_what_learns_with_ddpg() -> None:
    point = {"c_g": 0.8}
    stages = {"relabelling": "relay", "relay_chance": 0.5, "relay_share": 0.15}
    further: list[dict[str, Any]] = [{"success_history": 50}, {"mask_input": True}, stages]
    settings = [point, *({**point, **one} for one in further)]
    runs = [run([0.6] * 3, seed, **one) for one in settings for seed in (0, 1)]
    pairs = [(row["algorithm"], row["setting"], row["baseline"]) for row in comparisons(runs)]
    ddpg = "DDPG + HER"
    assert pairs == [
        (ddpg, "CGM, h = 50 (80 %, 32)", "CGM (80 %, 32)"),
        ("", f"{ddpg} (mask as input), CGM (80 %, 32)", f"{ddpg}, CGM (80 %, 32)"),
        (
            "",
            f"{ddpg} (stages by 50 %, 15 % of hindsight), CGM (80 %, 32)",
            f"{ddpg}, CGM (80 %, 32)",
        ),
    ]


@pytest.mark.parametrize(
    "other",
    [
        [
            run([0.6] * 3, 5, curriculum="full"),
            run([0.6] * 3, 1, curriculum="full"),
        ],  # one seed in common
        [
            run([0.0] * 3, seed, curriculum="full", leave_at=0.2) for seed in (0, 1)
        ],  # left before 50 %
    ],
)
def test_pairs_that_cannot_be_compared_are_left_out(other: list) -> None:
    assert comparisons([run([0.6] * 3, 0), run([0.6] * 3, 1), *other]) == []


def test_arms_that_both_learn_nothing_are_not_compared() -> None:
    runs = [run([0.1] * 5, seed, curriculum=name) for seed in range(3) for name in ("cgm", "full")]
    assert comparisons(runs) == []
