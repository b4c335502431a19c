from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from experiments.learning.overview import LOOKS, overview
from tests.experiments.learning.recorded import run


def medians(panel: Axes) -> list[Line2D]:
    return [line for line in panel.get_lines() if not str(line.get_label()).startswith("_")]


def values(line: Line2D) -> np.ndarray:
    """Points [k, 2] of a line."""
    return np.array(line.get_xydata())


def test_as_many_lines_as_there_are_looks_are_told_apart() -> None:
    rates = [n / 100 for n in range(len(LOOKS))]
    figure = overview([run([0.1, rate], c_g=rate) for rate in rates])
    above, below = figure.axes
    lines = medians(above)
    looks = {(line.get_color(), line.get_marker(), line.get_linestyle()) for line in lines}
    labels = [str(line.get_label()) for line in lines]
    assert len(looks) == len(set(labels)) == len(LOOKS) >= 10
    assert labels[:2] == ["CGM (0 %, 32)", "CGM (1 %, 32)"]
    np.testing.assert_allclose([values(line)[-1, 1] for line in lines], rates)
    rows = [label.get_text() for label in below.get_yticklabels()]
    assert rows == [f"{label}, one seed" for label in labels]
    plt.close(figure)
    with pytest.raises(ValueError, match="15 lines"):
        overview([run([0.1], c_g=n / 100) for n in range(15)])


def test_a_run_that_left_counts_on_and_one_that_never_held_is_a_cross() -> None:
    left = run([0.0, 0.9, 0.9, 0.9], 0, leave_at=0.9, epochs=6)
    later = run([0.0, 0.0, 0.9, 1.0, 1.0], 1, leave_at=0.9, epochs=6)
    never = run([0.0, 0.1, 0.1, 0.1, 0.1, 0.1], 2, leave_at=0.9)
    figure = overview([left, later, never])
    above, below = figure.axes
    (median,) = medians(above)
    np.testing.assert_allclose(values(median)[:, 1], [0.0, 0.1, 0.9, 0.9, 0.9, 0.9])
    marks = [line for line in below.get_lines() if len(values(line)) == 1]
    assert [values(line)[0, 0] for line in marks] == [4000, 5000, 6000]
    assert [line.get_marker() == "x" for line in marks] == [False, False, True]
    assert len({values(line)[0, 1] for line in marks}) == 3  # beside each other
    plt.close(figure)


def test_tasks_have_columns_and_only_what_differs_is_named() -> None:
    others: list[dict[str, Any]] = [{}, {"mask_input": True}, {"her_masks": True}]
    runs = [run([0.2, 0.3], **other) for other in others]
    half = run([0.4, 0.5], env="pick_and_place", air_probability=0.5)
    figure = overview([*runs, half])
    titles = [panel.get_title() for panel in figure.axes[:2]]
    assert titles == ["push", "pick-and-place, 50 % in the air"]
    labels = [str(line.get_label()) for line in medians(figure.axes[0])]
    assert labels == [
        *("DDPG + HER", "DDPG + HER (mask as input)", "DDPG + HER (masked hindsight)")
    ]
    assert [str(line.get_label()) for line in medians(figure.axes[1])] == ["DDPG + HER"]
    plt.close(figure)
    alone = overview([run([0.2])])
    assert [str(line.get_label()) for line in medians(alone.axes[0])] == ["CGM (10 %, 32)"]
    plt.close(alone)


def test_a_run_that_was_to_be_shorter_does_not_count_on() -> None:
    figure = overview([run([0.1] * 3, 0), run([0.3] * 5, 1)])
    (median,) = medians(figure.axes[0])
    np.testing.assert_allclose(values(median), [[1000, 0.2], [2000, 0.2], [3000, 0.2]])
    plt.close(figure)
