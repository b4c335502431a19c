"""The report says what the records say."""

import re
import shutil
import sys
from pathlib import Path

import pytest

from cgm_jax.storage.layout import CONFIG, METRICS
from experiments import run
from experiments.learning import records
from experiments.learning.plans import read_plans, runs_of
from experiments.markdown import (
    Table,
    counted,
    in_words,
    markdown,
    percent,
    without_constant_columns,
)
from experiments.report import README, SCREENS_OF_QUESTIONS, TABLE, VALUE, answered, regenerated
from experiments.run import tables_of
from experiments.table import read_table, write_table

SWEEPS = records.SWEEPS

# Numbers that sentences may state without a record: they describe settings, levels and definitions,
# or are printed in the paper.
STATED = {
    *("0", "1", "2", "4", "10", "20", "30", "32", "40", "50", "60", "80", "90"),  # c_g, levels
    *("5", "8", "10", "16", "57", "64", "95", "100", "120"),  # sizes of a design
    *("1,000", "20,000", "25,600", "10,000", "2,000", "2,000,000"),  # epochs and budgets
    *("51,200", "204,800", "3.6", "4.1", "35", "61"),  # the paper's steps, some in millions
    *("70", "110", "170", "300"),  # the paper's epochs
    *("3.3", "1.4.2", "3.3.7"),  # versions
    *("300,000", "550,000", "55,000", "150,000"),  # of other programs
}


def test_tables_and_numbers_are_those_of_the_records() -> None:
    text = README.read_text()
    assert regenerated(text) == text, "python -m experiments.run --report"
    assert len(TABLE.findall(text)) > 15
    assert len(VALUE.findall(text)) > 15


@pytest.mark.parametrize("question", read_plans().questions)
def test_tables_of_questions_are_those_of_the_records(question: str, tmp_path: Path) -> None:
    runs = runs_of(question)
    made = (run.RESULTS / question).is_dir()
    assert made >= answered(question)
    for name, rows in (tables_of(runs) if made else {}).items():
        written = run.RESULTS / question / name
        assert written.is_file() == bool(rows)
        if rows:
            write_table(tmp_path / name, rows)
            assert read_table(written) == read_table(tmp_path / name)


def test_another_record_makes_another_report(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shutil.copytree(records.SWEEPS, tmp_path / "sweeps")
    monkeypatch.setattr(records, "SWEEPS", tmp_path / "sweeps")
    path = tmp_path / "sweeps" / "push_her" / records.LEARNING
    rows = read_table(path)
    for row in rows:
        if row["seed"] == "1":
            row["success_rate"] = str(float(int(row["epoch"]) > 14))
    write_table(path, rows)
    value, table = "<!-- value: latest push_her 90 -->", "<!-- table: speed push -->"
    before = README.read_text()
    assert f"{value}320,000<!-- end -->" in before
    assert f"\n{table}\n" in before
    assert "| 180, 200, 180, 220, 160 |" in before
    after = regenerated(f"p = {value}<!-- end -->\n{table}\n<!-- end -->\n")
    assert f"{value}340,000<!-- end -->" in after
    assert "| 180, 320, 180, 220, 160 |" in after


SCREENS_ON_FILE = sorted(SCREENS_OF_QUESTIONS.glob("*.md"))


@pytest.mark.parametrize("path", [README, *SCREENS_ON_FILE], ids=lambda path: path.stem)
def test_numbers_in_sentences_come_from_records_or_are_settings(path: Path) -> None:
    text = VALUE.sub("", TABLE.sub("", path.read_text()))
    text = re.sub(r"`[^`]*`|\]\([^)]*\)|^    .*$", "", text, flags=re.MULTILINE)  # code, links
    text = re.sub(r"Fig\. \d|C51|x64|v\d", "", text)
    numbers = re.findall(r"(?<![\w.])\d[\d,]*(?:\.\d+)*", text)
    unknown = {number.rstrip(",") for number in numbers} - STATED
    assert not unknown, "state them in a table or as a value, or add what is a setting to STATED"
    small = "|".join(map(in_words, range(10)))
    counts = re.findall(rf"\b(?:no|{small}) of (?:{small})\b", text)
    assert not counts, "state them as values: held_by, sooner"


@pytest.mark.parametrize("path", SCREENS_ON_FILE, ids=lambda path: path.stem)
def test_a_screen_is_understood_before_there_is_a_record(
    path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(records, "SWEEPS", tmp_path)
    assert path.stem in read_plans().questions
    assert "Nothing is on record yet." in regenerated(path.read_text())


def test_a_question_has_its_screen_once_a_sweep_of_its_own_is_on_record(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(records, "SWEEPS", tmp_path)
    text = "<!-- screens -->\n<!-- end of screens -->\n"
    heading = f"## {read_plans().questions['networks_see'].text}"
    first = Path(
        shutil.copytree(SWEEPS / "pick_and_place_her_cgm", tmp_path / "pick_and_place_her_cgm")
    )
    assert heading not in regenerated(text)  # this sweep is another question's too
    shutil.copytree(first, tmp_path / "pick_and_place_mask_input")
    config = tmp_path / "pick_and_place_mask_input" / CONFIG
    changed = config.read_text().replace('"seed": ', '"mask_input": true, "seed": ')
    config.write_text(changed)
    written = regenerated(text)
    assert written.count(heading) == 1
    assert "| DDPG + HER (mask as input) | 500, 520, 440, 620, 500 |" in written
    assert (
        "`pick_and_place_her_masks`, `pick_and_place_mask_input_her_masks`<!-- end -->" in written
    )
    assert regenerated(written) == written


def test_a_marker_that_nobody_understands_is_named() -> None:
    with pytest.raises(ValueError, match="no 'moon'"):
        regenerated("a <!-- value: moon 3 --><!-- end -->")
    with pytest.raises(ValueError, match="no 'moon'"):
        regenerated("<!-- table: moon -->\n<!-- end -->\n")


def test_a_line_must_not_begin_with_a_value() -> None:
    with pytest.raises(ValueError, match="begins with a value"):
        regenerated("p =\n<!-- value: smallest_p 3 --><!-- end -->\n")


def test_a_value_is_replaced_where_it_stands() -> None:
    three, five = "<!-- value: smallest_p 3 -->", "<!-- value: smallest_p 5 -->"
    text = f"p = {three}1 %<!-- end -->, {five}<!-- end -->"
    expected = f"p = {three}0.25<!-- end -->, {five}0.062<!-- end -->"
    assert regenerated(text) == expected == regenerated(expected)


def test_the_program_refuses_what_it_cannot_do(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for arguments, message in (
        ([], "name questions"),
        (["--report", "push"], "name questions"),
        (["moon"], "no question 'moon'"),
        (["push", "--at-once", "0"], "--at-once"),
        (["push", "--only", "quick"], "'quick' is no sweep of theirs"),
        (["push", "--train", "--draw"], "not allowed with"),
        (["--report", "--again"], "--again"),
    ):
        monkeypatch.setattr(sys, "argv", ["run", *arguments])
        with pytest.raises(SystemExit) as end:
            run.main()
        assert end.value.code == 2
        assert message in capsys.readouterr().err


def test_markdown_by_hand() -> None:
    table = Table(["task", "a", "b"], [["push", "1", "2"], ["push", "3", "2"]])
    assert (
        markdown(table)
        == "| task | a | b |\n| --- | --- | --- |\n| push | 1 | 2 |\n| push | 3 | 2 |\n"
    )
    assert without_constant_columns(table, 2).header == ["a", "b"]
    assert markdown(Table(["a"], [], "None.")) == "None.\n"
    assert (percent(0.125), percent(0.125, 1), percent(1.0)) == ("12 %", "12.5 %", "100 %")
    assert (counted(1, "seed"), counted(9, "seed"), counted(12, "seed")) == (
        *("one seed", "nine seeds", "12 seeds"),
    )


def test_a_question_is_drawn_from_its_record(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(run, "RESULTS", tmp_path / "results")
    monkeypatch.setattr(run, "README", tmp_path / "README.md")
    (tmp_path / "README.md").write_text("p = <!-- value: smallest_p 3 --><!-- end -->\n")
    monkeypatch.setattr(sys, "argv", ["run", "reach", "--draw", "--runs", str(tmp_path)])
    run.main()
    written = {path.name for path in (tmp_path / "results" / "reach").iterdir()}
    assert written == {"speed.csv", "learning_curves.png"}
    assert "0.25" in (tmp_path / "README.md").read_text()


def test_some_sweeps_of_a_question_are_trained_and_nothing_is_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    asked_for: dict[str, list[str]] = {}
    monkeypatch.setattr(run, "train", lambda sweeps, *_: asked_for.update(sweeps))
    monkeypatch.setattr(run, "README", tmp_path / "README.md")
    monkeypatch.setattr(run, "is_on_record", lambda sweep, _: sweep == "push_by_full")
    options = ["curricula", "--train", "--only", "push_by_vds", "push_by_full"]
    monkeypatch.setattr(sys, "argv", ["run", *options])
    run.main()
    assert list(asked_for) == ["push_by_vds"]  # the other is on record
    assert "--curriculum vds" in " ".join(asked_for["push_by_vds"])
    assert capsys.readouterr().out == "push_by_full: on record; --again trains it again\n"
    monkeypatch.setattr(sys, "argv", ["run", *options, "--again"])
    run.main()
    assert list(asked_for) == ["push_by_vds", "push_by_full"]
    assert not (tmp_path / "README.md").exists()


def test_a_directory_that_would_cost_a_record_stops_the_program(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(records, "SWEEPS", Path(shutil.copytree(SWEEPS, tmp_path / "sweeps")))
    monkeypatch.setattr(run, "README", tmp_path / "README.md")
    runs = tmp_path / "runs"
    records.restore("push_her", runs / "push_her")
    metrics = runs / "push_her" / METRICS
    metrics.write_text("".join(metrics.read_text().splitlines(keepends=True)[:-1]))
    before = (tmp_path / "sweeps" / "push_her" / records.LEARNING).read_text()
    words = ["run", "push", "--draw", "--runs", str(runs)]
    monkeypatch.setattr(run, "RESULTS", tmp_path / "results")
    (tmp_path / "README.md").write_text("\n")
    monkeypatch.setattr(sys, "argv", words)
    run.main()  # what is on record stays without being asked for
    monkeypatch.setattr(sys, "argv", [*words, "--again"])
    with pytest.raises(SystemExit, match="seed4 is on record and not done here") as end:
        run.main()
    assert str(end.value).startswith("error: ")
    assert (tmp_path / "sweeps" / "push_her" / records.LEARNING).read_text() == before


def test_what_is_done_is_not_trained_again_in_place(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    records.restore("push_her", tmp_path / "push_her")
    monkeypatch.setattr(run, "train", lambda *_: pytest.fail("it is trained"))
    monkeypatch.setattr(sys, "argv", ["run", "push", "--again", "--runs", str(tmp_path)])
    with pytest.raises(SystemExit) as end:
        run.main()
    assert end.value.code == 2
    assert "push_her is done; name another --runs" in capsys.readouterr().err


def test_a_record_of_fewer_runs_than_are_planned_now_is_to_be_trained() -> None:
    planned = read_plans().sweeps["push_her"]
    assert run.is_on_record("push_her", planned)
    assert not run.is_on_record("push_her", {**planned, "seed": list(range(6))})


def test_a_record_that_would_be_lost_goes_only_if_it_is_asked_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    plans = read_plans()
    longer = {**plans.sweeps, "push_her": {**plans.sweeps["push_her"], "epochs": 30}}
    monkeypatch.setattr(run, "read_plans", lambda: plans._replace(sweeps=longer))
    asked_for: dict[str, list[str]] = {}
    monkeypatch.setattr(run, "train", lambda sweeps, *_: asked_for.update(sweeps))
    words = ["run", "push", "--train", "--runs", str(tmp_path)]
    monkeypatch.setattr(sys, "argv", words)
    with pytest.raises(SystemExit) as end:
        run.main()
    assert end.value.code == 2
    assert "is on record with other settings than are planned" in capsys.readouterr().err
    assert not asked_for
    monkeypatch.setattr(sys, "argv", [*words, "--again"])
    run.main()
    assert list(asked_for) == ["push_her"]


def test_a_record_of_other_runs_than_planned_is_refused() -> None:
    planned = read_plans().sweeps["reach_her"]
    assert len(run.runs_on_record("reach_her", planned)) == 1
    with pytest.raises(ValueError, match="other runs than are planned"):
        run.runs_on_record("reach_her", {**planned, "discount": 0.9})


def test_a_question_without_a_record_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(records, "SWEEPS", tmp_path)
    plans = read_plans()
    with pytest.raises(ValueError, match="nothing is on record"):
        run.write_results("reach", plans.questions["reach"], plans)
