"""Rows of metrics in memory and as lines."""

import numpy as np
import pytest

from cgm_jax.storage.metrics import from_lines, plain_row, to_lines

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


def test_rows_become_lines_of_json_and_lines_the_same_rows() -> None:
    assert to_lines([ROW, ROW]) == LINE + LINE
    assert from_lines((LINE + LINE).splitlines()) == [ROW, ROW]
    assert to_lines(from_lines([LINE])) == LINE


@pytest.mark.parametrize("line", ["[]", "1", "", "{", '{"a": 1} {}'])
def test_a_line_that_is_no_object_is_refused(line: str) -> None:
    with pytest.raises(ValueError, match=r".+"):
        from_lines([LINE, line])
