"""Tables of the report from runs made up."""

import dataclasses

import pytest

from experiments.learning import report_tables, report_values
from experiments.learning.plans import Plans, Question
from experiments.learning.records import RecordedRun
from tests.experiments.learning.recorded import run


@pytest.fixture
def question(monkeypatch: pytest.MonkeyPatch) -> list[RecordedRun]:
    """The runs of every question, to be filled."""
    runs: list[RecordedRun] = []
    monkeypatch.setattr(report_tables, "runs_of", lambda _: runs)
    monkeypatch.setattr(report_tables, "recorded_runs", lambda _: runs)
    return runs


def test_speed_shows_every_seed_and_who_left(question: list[RecordedRun]) -> None:
    learns, never = [0.0, 0.9, 0.9, 0.9], [0.0] * 5
    question += [run(learns, 0, leave_at=0.9, epochs=5), run(never, 1, leave_at=0.9)]
    question += [run([0.5] * 4, 2, curriculum="full", leave_at=0.5, epochs=5)]
    table = report_tables.speed("any")
    assert table.header[0] == "masks"  # task and algorithm are the same
    assert list(table.rows[0]) == [
        "CGM (10 %, 32)",
        *("3, never", "never"),
        *("4, never", "never"),
        *("left, 0", "5"),
    ]
    assert list(table.rows[1]) == [
        *("no masks, seeds 2", "3", "3", "not trained for", "", "left", "4"),
    ]


def test_never_says_by_when_where_others_of_the_setting_were_trained_longer(
    question: list[RecordedRun],
) -> None:
    question += [run([0.0] * 5, 0), run([0.0] * 9, 1), run([0.5] * 9, 2)]
    assert "never by 5, never, 3" in report_tables.speed("any").rows[0]


def test_seconds_to_hold_are_those_of_every_seed_and_their_median(
    question: list[RecordedRun],
) -> None:
    # Evaluated every 2 seconds: 50 % is held at the 2nd to 4th, 90 % at the 3rd to 5th.
    question += [run([0.0] * zeros + [0.9] * 4, seed) for seed, zeros in ((0, 0), (1, 2))]
    question += [run([0.6] * 6, 2, curriculum="full"), run([0.0] * 6, 3, curriculum="full")]
    table = report_tables.seconds_to_hold("any")
    assert [list(row) for row in table.rows] == [
        ["CGM (10 %, 32)", "6, 8", "7", "6, 10", "8"],
        ["no masks, seeds 2, 3", "6, never", "never", "never, never", "never"],
    ]
    question[0] = dataclasses.replace(question[0], alone=False)
    with pytest.raises(ValueError, match="side by side have no seconds of their own"):
        report_tables.seconds_to_hold("any")


def test_two_trainings_stand_beside_each_other_setting_by_setting(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    first = [run([0.9] * 4, 0), run([0.0] * 4, 1), run([0.9] * 4, 0, curriculum="full")]
    second = [run([0.9] * 4, 0, "b"), run([0.0] * 2 + [0.9] * 4, 1, "b")]
    trainings = {"one": first, "two": [*second, run([0.9] * 4, 0, "b", her_filter=False)]}
    monkeypatch.setattr(report_tables, "runs_of", trainings.__getitem__)
    table = report_tables.trained_twice("one", "two", "90")
    # Of the others there is but one training.
    (row,) = table.rows
    assert list(row)[-4:] == ["3, never", "never", "3, 5", "4 (3.5 to 4.5)"]


def test_paired_says_how_large_a_difference_is_at_least(question: list[RecordedRun]) -> None:
    question += [run([0.5] * 9, seed) for seed in (0, 1)]
    question += [
        run([0.0] * 2 + [0.5] * 7, 0, curriculum="full"),
        run([0.0] * 9, 1, curriculum="full"),
    ]
    (row,) = report_tables.paired("any", "50").rows
    # 3 against 5 and against never, counted as 9: a bound of the mean, and no interval.
    assert list(row) == [
        *("CGM (10 %, 32) - no masks", "50 %", "-2, < -6", "< -4", "0.5", "100 %"),
    ]


def test_paired_has_an_interval_where_all_differences_are_known(
    question: list[RecordedRun],
) -> None:
    question += [run([0.5] * 9, seed) for seed in (0, 1)]
    question += [
        run([0.0] * zeros + [0.5] * 7, i, curriculum="full") for i, zeros in ((0, 2), (1, 6))
    ]
    (row,) = report_tables.paired("any", "50").rows
    # -2 and -6; t of one degree of freedom is 12.706.
    assert list(row)[2:4] == ["-2, -6", "-4 (-29.4 to 21.4)"]


def test_paired_says_where_nothing_is_known_of_a_difference(question: list[RecordedRun]) -> None:
    question += [run([0.5] * 9, 0), run([0.0] * 9, 1)]
    question += [
        run([0.0] * 2 + [0.5] * 7, 0, curriculum="full"),
        run([0.0] * 9, 1, curriculum="full"),
    ]
    (row,) = report_tables.paired("any", "50").rows
    assert list(row)[2:4] == ["-2, ?", "?"]


def test_a_grid_has_epochs_by_seed(question: list[RecordedRun]) -> None:
    question += [run([0.5] * 4, seed, c_g=c_g) for c_g in (0.0, 0.4) for seed in (0, 1)]
    question += [run([0.0] * 4, 0, kappa=4.0, c_g=0.4), run([0.5] * 3, 0, curriculum="full")]
    table = report_tables.grid("any", "push")
    assert list(table.header) == ["c_g", "0 %", "40 %"]
    assert [list(row) for row in table.rows] == [
        ["kappa = 4", "", "never"],
        ["kappa = 32", "3, 3", "3, 3"],
        ["no masks: 3", "", ""],
    ]
    assert report_tables.grid("any", "reach").rows == []


def test_what_moved_the_block_is_shown_per_seed_as_far_as_it_is_known(
    question: list[RecordedRun],
) -> None:
    question += [run([0.6] * 4, 0), run([0.0] * 2, 0, curriculum="full"), run([0.0] * 2, 1)]
    for row, share in zip(question[0].rows, (0.1, 0.3, 0.5, None), strict=True):
        row["moved_share"] = share
    for row in question[1].rows:
        row["moved_share"] = 0.04
    table = report_tables.moved_episodes("any", "2000")
    assert list(table.header)[-2:] == ["moved, 0 to 2", "moved, 2 to 4"]
    assert [list(row) for row in table.rows] == [
        ["CGM (10 %, 32)", "0", "3", "never", "20 %", "50 %"],
        ["no masks", "0", "never", "never", "4 %", ""],
    ]
    question.append(run([0.0] * 2, her_filter=False))
    question[-1].rows[0]["moved_share"] = 0.3
    table = report_tables.moved_episodes("any", "2000")
    assert list(table.header)[:2] == ["algorithm", "masks"]
    assert table.rows[-1][0] == "DDPG + HER (from all episodes)"
    question.clear()
    assert report_tables.moved_episodes("any", "2000").rows == []


def test_what_is_not_trained_is_listed(monkeypatch: pytest.MonkeyPatch) -> None:
    questions = {
        "why": Question("Why?", ["a", "b"], []),
        "how": Question("How?", ["b", "c"], []),
        "who": Question("Who?", ["b"], []),
    }
    planned = {"a": 3, "b": 3, "c": 3}
    recorded = {"a": 0, "b": 3, "c": 1}
    for module in (report_tables, report_values):
        monkeypatch.setattr(module, "read_plans", lambda: Plans({}, questions))
    monkeypatch.setattr(report_values, "recorded_settings", lambda sweep: [sweep] * planned[sweep])
    monkeypatch.setattr(report_values, "recorded_runs", lambda sweep: [sweep] * recorded[sweep])
    for module in (report_tables, report_values):
        monkeypatch.setattr(module, "is_whole", lambda sweep: planned[sweep] == recorded[sweep])
    rows = report_tables.planned().rows
    assert [list(row) for row in rows] == [
        ["Why?", "`why`", "1 of 2"],
        ["How?", "`how`", "1 of 2"],
    ]
    assert report_values.not_trained("why") == "`a`"
    assert report_values.not_trained("how") == "`c` (1 of 3 runs are)"
    assert report_values.not_trained("who") == "nothing"


def test_stages_of_a_curriculum_by_hand(question: list[RecordedRun]) -> None:
    question += [run([0.1, 0.3, 0.9])]
    for row, full in zip(question[0].rows, (0.2, 0.4, 1.0), strict=True):
        row["mask_probability"] = [0.0, 0.06, 0, 0, 0, 0, 0.02, full]
        row["mask_rate_training"] = [None] * 7 + [0.5 * full]
    rows = report_tables.mask_stages("any", "2000").rows
    assert [list(row) for row in rows] == [
        ["0 to 2", "20 %", "30 %", "2 %", "6 %", "15 %"],
        ["2 to 4", "90 %", "100 %", "2 %", "6 %", "50 %"],
    ]
