import itertools
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from experiments.learning.comparison import comparison
from tests.experiments.learning.recorded import run

CURRICULA: list[dict[str, Any]] = [
    {"curriculum": "full"},
    {},
    {"factorised": False},
    {"masked_evaluation_episodes": 10},
    {"curriculum": "uniform"},
]
ALGORITHMS: list[dict[str, Any]] = [{"her": False}, {}, {"her_filter": False}]


def medians(figure: Figure) -> list[Line2D]:
    (panel,) = figure.axes
    return [line for line in panel.get_lines() if not str(line.get_label()).startswith("_")]


def test_every_algorithm_has_a_line_that_looks_like_no_other() -> None:
    settings = list(itertools.product(ALGORITHMS, CURRICULA))
    runs = [run([0.1, 0.05 * n], **one, **other) for n, (one, other) in enumerate(settings)]
    figure = comparison(runs)
    lines = medians(figure)
    assert len({(line.get_color(), line.get_linestyle()) for line in lines}) == 15
    assert len({line.get_label() for line in lines}) == 15
    ends = [np.asarray(line.get_ydata())[-1] for line in lines]
    np.testing.assert_allclose(ends, [0.05 * n for n in range(15)])
    plt.close(figure)


def test_settings_that_would_look_alike_do_not() -> None:
    others: list[dict[str, Any]] = [{}, {"c_g": 0.4}, {"full_share": 0.1}, {"mask_input": True}]
    figure = comparison([run([0.1, 0.2], **other) for other in others])
    lines = medians(figure)
    assert len({(line.get_color(), line.get_linestyle()) for line in lines}) == 4
    assert len({line.get_label() for line in lines}) == 4
    plt.close(figure)


def test_few_seeds_have_a_line_each_and_a_median_as_far_as_all_were_trained() -> None:
    rates = ([0.1, 0.2, 0.9], [0.3, 0.4], [0.5, 0.0, 0.0])
    figure = comparison([run(list(r), seed, epochs=3) for seed, r in enumerate(rates)])
    (median,) = medians(figure)
    np.testing.assert_allclose(np.array(median.get_xydata()), [[1000, 0.3], [2000, 0.2]])
    thin = [line for line in figure.axes[0].get_lines() if line.get_linewidth() == 0.6]
    assert [len(np.asarray(line.get_ydata())) for line in thin] == [3, 2, 3]
    (dot,) = [line for line in figure.axes[0].get_lines() if line.get_marker() == "."]
    np.testing.assert_allclose(np.array(dot.get_xydata()), [[2000, 0.4]])  # where seed 1 left
    assert not figure.axes[0].collections
    plt.close(figure)


def test_ten_seeds_have_quartiles() -> None:
    figure = comparison([run([0.1 * seed, 0.1 * seed], seed) for seed in range(10)])
    assert len(figure.axes[0].collections) == 1
    plt.close(figure)


def test_how_long_random_actions_last_is_said_where_it_differs() -> None:
    runs = [run([0.1], random_action_steps=steps) for steps in (1, 5)]
    figure, alone = comparison(runs), comparison(runs[:1])
    assert [str(line.get_label()).split(", ")[-2] for line in medians(figure)] == [
        "random actions of one step",
        "random actions of five steps",
    ]
    assert "random" not in str(medians(alone)[0].get_label())
    plt.close("all")
