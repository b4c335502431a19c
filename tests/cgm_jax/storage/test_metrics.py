"""Rows of metrics in memory and as lines."""

import csv
import io
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cgm_jax.storage.metrics import check_row, check_rows, from_lines, plain_row, to_csv, to_lines

ROW = plain_row(
    {
        "run": "ä",
        "hidden_layers": (8, 16),
        "success_rate": np.float32(0.1),
        "env_steps": np.int32(400),
        "mask_share": np.array([[0.25, np.nan], [np.inf, 1 / 3]], np.float32),
        "wall_s": float("nan"),
        "cgm": np.bool_(True),
        "failure": None,
    }
)
LINE = (
    r'{"run": "\u00e4", "hidden_layers": [8, 16], "success_rate": 0.1, "env_steps": 400, '
    r'"mask_share": [[0.25, null], [null, 0.3333333]], "wall_s": null, "cgm": true, '
    '"failure": null}\n'
)


def test_a_row_has_only_plain_values() -> None:
    assert ROW == {
        "run": "ä",
        "hidden_layers": [8, 16],
        "success_rate": 0.1,  # float32 has seven digits
        "env_steps": 400,
        "mask_share": [[0.25, None], [None, 0.3333333]],
        "wall_s": None,
        "cgm": True,
        "failure": None,
    }
    assert [type(value) for value in ROW.values()] == [
        *(str, list, float, int, list),
        *(type(None), bool, type(None)),
    ]


@pytest.mark.parametrize(
    ("value", "kept"),
    [
        (np.float32(3.2e-8), 3.2e-8),
        (np.float32(1.234567e-5), 1.234567e-5),
        (np.float32(123456.7), 123456.7),
        (np.float64(1 / 3), 0.3333333),
        (np.array([1e-9, 0.5, np.inf, -0.0], np.float32), [1e-9, 0.5, None, 0.0]),
        (np.zeros((2, 0)), [[], []]),
    ],
)
def test_numbers_of_any_size_keep_seven_digits(value: Any, kept: Any) -> None:
    assert plain_row({"value": value}) == {"value": kept}


def test_rows_become_lines_of_json_and_lines_the_same_rows() -> None:
    assert to_lines([ROW, ROW]) == LINE + LINE
    assert from_lines((LINE + LINE).splitlines()) == [ROW, ROW]
    assert to_lines(from_lines([LINE])) == LINE


@pytest.mark.parametrize("line", ["[]", "1", "", "{", '{"a": 1} {}'])
def test_a_line_that_is_no_object_is_refused(line: str) -> None:
    with pytest.raises(ValueError, match=r".+"):
        from_lines([LINE, line])


WHOLE = {
    "run": "a",
    "epoch": 1,
    "success_rate": None,
    "physics_warnings": 0,
    "failed_epoch": None,
    "failure": None,
}


def test_rows_are_those_of_each_run_and_epoch_in_order() -> None:
    rows = [{**WHOLE, "run": run, "epoch": epoch} for epoch in (1, 2) for run in ("a", "b")]
    check_rows(rows, ["a", "b"], 2)
    check_rows([], ["a", "b"], 0)
    for others, names, epochs in [
        (rows, ["b", "a"], 2),
        (rows[:3], ["a", "b"], 2),
        (rows, ["a", "b"], 3),
        (rows, ["a", "b"], 10**18),
        ([rows[2], rows[3], rows[0], rows[1]], ["a", "b"], 2),
    ]:
        with pytest.raises(ValueError, match="there is not one row per run and epoch"):
            check_rows(others, names, epochs)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("run", 5),
        ("run", ["a"]),
        ("epoch", True),
        ("epoch", 1.0),
        ("success_rate", "1"),
        ("physics_warnings", None),
        ("physics_warnings", float("nan")),
        ("run", "a\x1b[31m"),
        ("failure", "\x1b]52;c;aGk=\x07"),
        ("failure", 3),
        ("failed_epoch", "x"),
        ("swept", "seed"),
        ("reported", [1]),
    ],
)
def test_a_row_such_as_no_sweep_writes_is_refused(name: str, value: object) -> None:
    check_row(WHOLE)
    with pytest.raises(ValueError, match=f"^{name}: .* in a row$"):
        check_row({**WHOLE, name: value})


def test_a_table_has_a_cell_per_number_and_a_word_per_swept_setting() -> None:
    swept = {"swept": ["hidden_layers"], "reported": ["a", "b"]}
    shared = {"success_rate": 0.5, "cgm": True, "failure": None, **swept}
    rows = [
        {
            **shared,
            "hidden_layers": [8, 16],
            "swept": ["hidden_layers"],
            "mask_share": [0.25, None],
        },
        {**shared, "hidden_layers": [8], "mask_share": None},
    ]
    one, other = csv.DictReader(io.StringIO(to_csv(rows)))
    assert one == {
        "success_rate": "0.5",
        "cgm": "True",
        "failure": "",
        "reported": "a b",
        "hidden_layers": "8x16",
        "swept": "hidden_layers",
        "mask_share_0": "0.25",
        "mask_share_1": "",
    }
    assert (other["hidden_layers"], other["mask_share_0"]) == ("8", "")


def test_a_number_keeps_its_column_beside_one_that_is_named_as_if_it_were_a_list() -> None:
    assert to_csv([{"goal": 0.5, "goal_0": 0.25}]) == "goal,goal_0\n0.5,0.25\n"


def test_a_table_names_the_cells_of_lists_of_lists_and_quotes_words_with_commas() -> None:
    text = to_csv([{"run": "a,b", "share": [[1, 2], [3, 4]]}])
    assert text == 'run,share_0_0,share_0_1,share_1_0,share_1_1\n"a,b",1,2,3,4\n'


def test_the_readmes_lines_of_pandas_read_metrics(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("pandas", reason="make setup has it")
    points = [("cgm", 0.1, 4.0), ("cgm", 0.4, 4.0), ("full", None, None)]
    rows = [
        {
            **dict(zip(("curriculum", "c_g", "kappa"), point, strict=True)),
            **{"seed": seed, "epoch": epoch, "success_rate": 0.1 * number + 0.05 * seed * epoch},
        }
        for number, point in enumerate(points)
        for seed in range(3)
        for epoch in (1, 2)
    ]
    folder = tmp_path / "runs" / "sweep"
    folder.mkdir(parents=True)
    (folder / "metrics.jsonl").write_text("".join(json.dumps(row) + "\n" for row in rows))
    monkeypatch.chdir(tmp_path)
    readme = (Path(__file__).parents[3] / "README.md").read_text()
    exec(readme.split("<!-- pandas -->\n```python\n")[1].split("```")[0], {})
    lines = [line.split() for line in capsys.readouterr().out.splitlines()]
    assert lines[-3:] == [  # medians over seeds: those of seed 1
        ["cgm", "0.1", "4.0", "0.05", "0.1"],
        ["0.4", "4.0", "0.15", "0.2"],
        ["full", "NaN", "NaN", "0.25", "0.3"],
    ]


def test_no_text_in_a_table_is_a_formula() -> None:
    texts = ("=HYPERLINK(1)", "+1", "-1", "@a", "a=1")
    cells = [
        row["failure"]
        for row in csv.DictReader(io.StringIO(to_csv([{"failure": text} for text in texts])))
    ]
    assert cells == ["'=HYPERLINK(1)", "'+1", "'-1", "'@a", "a=1"]
    assert to_csv([{"value": -1.5}]) == "value\n-1.5\n"
