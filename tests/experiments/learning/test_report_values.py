"""Numbers in sentences of the report, from runs made up."""

from collections.abc import Callable, Sequence
from pathlib import Path

import pytest

from experiments.learning import report_values
from experiments.learning.plans import Plans, Question
from experiments.learning.records import RecordedRun
from experiments.markdown import NOT_YET
from experiments.table import write_table
from tests.experiments.learning.recorded import run

Recorded = dict[str, list[RecordedRun]]

SWEEPS = ("one", "other", "more", "less", "nothing")


@pytest.fixture
def recorded(monkeypatch: pytest.MonkeyPatch) -> Recorded:
    """The runs of every sweep that is planned, to be filled."""
    runs: Recorded = {name: [] for name in SWEEPS}
    plans = Plans({key: {} for key in SWEEPS}, {"why": Question("Why?", SWEEPS, [])})
    monkeypatch.setattr(report_values, "read_plans", lambda: plans)
    monkeypatch.setattr(report_values, "recorded_runs", runs.__getitem__)
    return runs


def arm(name: str, curves: Sequence[Sequence[float]], first: int = 0) -> list[RecordedRun]:
    """Runs of a sweep, by its name all of one setting, that are to train for nine epochs."""
    settings = {"curriculum": "full"} if name == "other" else {}
    return [
        run(rates, seed, name, **{"epochs": 9, **settings})
        for seed, rates in enumerate(curves, start=first)
    ]


def held(epoch: int, level: float = 0.9) -> list[float]:
    """A curve of nine epochs that holds a level by an epoch."""
    return [0.0] * (epoch - 3) + [level] * (12 - epoch)


NEVER = [0.0] * 9


def test_held_by_counts_seeds(recorded: Recorded) -> None:
    recorded["one"] = arm("one", [held(5), NEVER, held(9, 0.5)])
    assert report_values.held_by("one", "90") == "one of three seeds"
    assert report_values.held_by("one", "50") == "two of three seeds"


def test_sweeps_of_one_setting_are_taken_together(recorded: Recorded) -> None:
    recorded["one"] = arm("one", [held(5), NEVER])
    assert report_values.held_by("one+more", "90") == "one of two seeds"  # as far as there are any
    recorded["more"] = arm("more", [held(9), held(4), NEVER], first=2)
    recorded["other"] = arm("other", [held(6), NEVER, held(9)])
    assert report_values.held_by("one+more", "90") == "three of five seeds"
    # By seed: 5 and 6, never both, 9 both; the others have no counterpart.
    assert report_values.sooner("one+more", "other", "90") == "one of three seeds"
    with pytest.raises(ValueError, match="2 settings, not one"):
        report_values.held_by("one+other", "90")


def test_the_least_ratio_is_rounded_down_and_counts_never_to_the_end(recorded: Recorded) -> None:
    recorded["one"] = arm("one", [held(3), held(4), held(5)])
    recorded["other"] = arm("other", [held(8), NEVER])
    assert report_values.least_ratio("one", "other", "90") == "2.2"  # of 8 / 3 and 9 / 4
    recorded["other"] = []
    assert report_values.least_ratio("one", "other", "90") == NOT_YET
    recorded["other"] = arm("other", [held(8)])
    recorded["one"] = arm("one", [NEVER])
    with pytest.raises(ValueError, match="not all seeds hold 90 %"):
        report_values.least_ratio("one", "other", "90")


def test_what_is_saved_is_compared_by_seed(recorded: Recorded) -> None:
    # Saved are 1, 2 and 2 thousand steps; elsewhere 2, 2 and, at least, 5.
    recorded["one"] = arm("one", [held(4), held(4), held(4)])
    recorded["other"] = arm("other", [held(5), held(6), held(6)])
    recorded["more"] = arm("more", [held(4), held(4), held(4)])
    recorded["less"] = arm("less", [held(6), held(6), NEVER, held(9)])
    names = ("one", "other", "more", "less")
    assert report_values.saved_less(*names, "90") == "two of three seeds"
    assert report_values.saved_less("one", "other", "one", "other", "90") == "none of three seeds"
    with pytest.raises(ValueError, match="less: not all seeds hold 50 %"):
        report_values.saved_less("more", "less", *names[:2], "50")
    recorded["more"] = []
    assert report_values.saved_less(*names, "90") == NOT_YET


def test_seeds_that_never_hold_a_success_have_one_end(recorded: Recorded) -> None:
    recorded["one"] = arm("one", [held(5), NEVER])
    recorded["more"] = [run(held(5), 2, "more", epochs=99), run(NEVER[:5], 3, "more")]
    with pytest.raises(ValueError, match=r"one\+more: not all seeds were trained as long for 90 %"):
        report_values.held_by("one+more", "90")
    assert report_values.held_by("more", "90") == "one of two seeds"
    recorded["more"] = [run(held(7), 2, "more", epochs=99), run(NEVER[:5], 3, "more")]
    with pytest.raises(ValueError, match="not all seeds were trained as long"):  # 7 is after 5
        report_values.held_by("more", "90")


def test_what_is_said_of_several_is_so_of_each(recorded: Recorded) -> None:
    recorded["one"] = arm("one", [held(5), NEVER])
    recorded["other"] = arm("other", [NEVER, held(7)])
    assert report_values.held_by("one,other", "90") == "one of two seeds"
    recorded["other"] = arm("other", [NEVER, NEVER])
    with pytest.raises(ValueError, match="not the same is so of each"):
        report_values.held_by("one,other", "90")


def test_sooner_leaves_ties_out_and_takes_never_for_the_latest(recorded: Recorded) -> None:
    recorded["one"] = arm("one", [held(5), held(6), held(9), NEVER, NEVER])
    recorded["other"] = arm("other", [held(6), held(6), NEVER, held(9), NEVER])
    assert report_values.sooner("one", "other", "90") == "two of five seeds"
    assert report_values.sooner("other", "one", "90") == "one of five seeds"


@pytest.mark.parametrize("names", [("one", "other"), ("other", "one")])
def test_which_is_sooner_is_not_known_beyond_the_shorter_training(
    names: tuple[str, str], recorded: Recorded
) -> None:
    recorded["one"] = arm("one", [held(5)])
    recorded["other"] = [run(NEVER[:5], 0, "other", curriculum="full")]
    assert report_values.sooner("one", "other", "90") == "one of one seed"
    recorded["one"] = arm("one", [held(6)])
    with pytest.raises(ValueError, match="seed 0: which is sooner is not known"):
        report_values.sooner(*names, "90")


def test_when_a_success_is_held(recorded: Recorded) -> None:
    recorded["one"] = arm("one", [held(5), held(9), held(4)])
    assert report_values.held_in("one", "90", "1") == "9,000"
    assert report_values.latest("one", "90") == "9,000"
    assert report_values.seconds("one", "90") == "8 to 18"
    assert report_values.budget("one") == "9,000"
    recorded["one"] = arm("one", [held(5), NEVER])
    for value in (report_values.latest, report_values.seconds):
        with pytest.raises(ValueError, match="not all seeds hold 90 %"):
            value("one", "90")


def test_how_often_the_full_goal_is_drawn_when_all_is_learned(recorded: Recorded) -> None:
    recorded["one"] = arm("one", [held(5)])
    for row, rate, drawn in zip(recorded["one"][0].rows, [0.5] + [1.0] * 8, range(9), strict=True):
        row["mask_rate_estimated"] = [1.0] * 7 + [rate]
        row["mask_probability"] = [0.0] * 7 + [0.1 + drawn / 1000]
    assert report_values.probability_of_full_goal("one") == "10.1 % to 10.8 %"


def test_how_often_the_goal_moved_up_to_a_step(recorded: Recorded) -> None:
    recorded["one"] = arm("one", [held(5), held(6)])
    for one, shares in zip(recorded["one"], ([0.1, 0.3], [0.3, 0.5]), strict=True):
        for row, share in zip(one.rows, [*shares, *[1.0] * 7], strict=True):
            row["moved_share"] = share
    assert report_values.moved("one", "2000") == "20 % to 40 %"


def test_which_commits_made_a_table(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(report_values, "SWEEPS", tmp_path / "sweeps")
    table = tmp_path / "table.csv"
    write_table(table, [{"commit": "0123456789ab"}] * 2)
    assert report_values.commits_of("table.csv") == "commit `0123456`"
    write_table(table, [{"commit": "fedcba987654-dirty"}, {"commit": "0123456789ab"}])
    expected = "commits `0123456`, `fedcba9` (with changes)"
    assert report_values.commits_of("table.csv") == expected


ONE_SWEEP: dict[str, Callable[[str], str]] = {
    "held_by": lambda sweep: report_values.held_by(sweep, "90"),
    "sooner": lambda sweep: report_values.sooner(sweep, "one", "90"),
    "budget": report_values.budget,
    "latest": lambda sweep: report_values.latest(sweep, "90"),
    "held_in": lambda sweep: report_values.held_in(sweep, "90", "0"),
    "seconds": lambda sweep: report_values.seconds(sweep, "90"),
    "moved": lambda sweep: report_values.moved(sweep, "1000"),
    "probability_of_full_goal": report_values.probability_of_full_goal,
}


@pytest.mark.parametrize("name", ONE_SWEEP)
def test_a_sweep_that_is_not_on_record_and_one_that_is_not_planned(
    name: str, recorded: Recorded
) -> None:
    recorded["one"] = arm("one", [held(5)])
    assert ONE_SWEEP[name]("nothing") == NOT_YET
    with pytest.raises(ValueError, match="no sweep 'noone' is planned"):
        ONE_SWEEP[name]("noone")


def test_a_point_at_which_a_seed_ties_is_not_sooner(monkeypatch: pytest.MonkeyPatch) -> None:
    curves = {0.1: [held(5), held(6)], 0.4: [held(5), held(7)], 0.8: [held(5), NEVER]}
    runs = [
        run(x, seed, "one", c_g=c_g) for c_g, two in curves.items() for seed, x in enumerate(two)
    ]
    runs += [run(held(7), seed, "other", curriculum="full") for seed in (0, 1)]
    monkeypatch.setattr(report_values, "runs_of", lambda _: runs)
    assert report_values.points_sooner("grid", "push") == "one of three points"


def test_the_pace_is_that_of_the_median_epoch_of_the_fastest_and_of_the_slowest_run(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    runs = [run([0.0] * 4, 0), run([0.0] * 4, 1)]  # of 2 s an epoch
    for row, wall in zip(runs[1].rows, (30.0, 33.0, 40.0, 43.5), strict=True):
        row["wall_s"] = wall
    monkeypatch.setattr(report_values, "runs_of", lambda _: runs)
    assert report_values.pace("any") == "2.0 to 3.5"
