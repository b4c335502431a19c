import itertools
from typing import Any

import matplotlib.pyplot as plt

from experiments.learning.comparison import comparison

CURRICULA: list[dict[str, Any]] = [
    {"cgm": False, "kappa": 32.0, "estimate": "product"},
    {"cgm": True, "kappa": 32.0, "estimate": "product"},
    {"cgm": True, "kappa": 32.0, "estimate": "joint"},
    {"cgm": True, "kappa": 32.0, "estimate": "measured"},
    {"cgm": True, "kappa": 0.0, "estimate": "product"},
]


def test_every_algorithm_has_a_line_that_looks_like_no_other() -> None:
    rows = []
    for number, (her, curriculum) in enumerate(itertools.product((False, True), CURRICULA)):
        fixed = {"env": "push", "her": her, "her_filter": True, **curriculum, "c_g": 0.1, "seed": 0}
        fixed |= {"sweep": "one", "run": str(number)}
        rates = enumerate((0.1, 0.1 * number), start=1)
        rows += [{**fixed, "env_steps": 1000 * i, "success_rate": rate} for i, rate in rates]
    figure = comparison(rows)
    (panel,) = figure.axes
    lines = [line for line in panel.get_lines() if len(line.get_xdata()) == 2][: len(CURRICULA) * 2]  # pyright: ignore[reportArgumentType]
    assert len({(line.get_color(), line.get_linestyle()) for line in lines}) == 10
    assert len({str(line.get_label()) for line in lines}) == 10
    assert [round(float(line.get_ydata()[-1]), 1) for line in lines] == [  # pyright: ignore[reportIndexIssue, reportArgumentType]
        round(0.1 * number, 1) for number in range(10)
    ]
    plt.close(figure)
