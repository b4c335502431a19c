import importlib
from typing import Any

import numpy as np
import pytest
from matplotlib.axes import Axes

from cgm_jax.results.figures import NothingToDraw, curriculum
from tests.cgm_jax.results.figures.made import heights, legend, panels, run, sweep, titles


def heat_map(panel: Axes) -> np.ndarray:
    """Values [rows, epochs] of a panel's heat map; NaN where there are none."""
    (mesh,) = panel.collections
    return np.ma.filled(np.ma.asarray(mesh.get_array(), float), np.nan)


def ticks(panel: Axes) -> list[str]:
    return [text.get_text() for text in panel.get_yticklabels()]


def reporting(**metrics: Any) -> dict[str, Any]:
    return {"reported": sorted(metrics), **metrics}


def test_levels_of_many_dimensions_are_a_heat_map_over_environment_steps() -> None:
    report = reporting(
        level_probability=lambda epoch: [0.1 * epoch] * 20 + [None],
        level=[i / 20 for i in range(21)],
    )
    (panel,) = panels(curriculum(run([0.5, 0.5], **report)))
    expected = np.tile([[0.1, 0.2]], (21, 1))
    expected[20] = np.nan
    np.testing.assert_allclose(heat_map(panel), expected)
    corners = panel.collections[0].get_coordinates()  # pyright: ignore[reportAttributeAccessIssue]
    assert corners[0, :, 0].tolist() == [0, 1000, 2000]
    assert panel.get_ylabel() == "level"
    assert ticks(panel) == [f"{i / 10:g}" for i in range(11)]
    assert panel.get_xlabel() == "env_steps (thousands)"


def test_arrays_are_named_by_the_longest_name_that_is_an_array_as_long() -> None:
    report = reporting(
        start_x=[0.5, 1.5, 2.5],
        start_x_rate=[0.1, 0.2, 0.3],
        goal=[1.0, 2.0],  # and no array has this length whose values it could name
        goal_share=0.4,
        goal_size=[1.0, 2.0, 3.0],
    )
    shown = panels(curriculum(run([0.5], **report)))
    # "start_x" names the rows of its rate; the others stand for themselves.
    assert [ticks(panel) for panel in shown if panel.collections] == [
        *(["0", "1"], ["0", "1", "2"], ["0.5", "1.5", "2.5"])
    ]
    assert [panel.get_ylabel() for panel in shown] == [
        *("goal, by number", "goal share", "goal, by number", "start_x")
    ]


def test_without_values_for_its_rows_an_array_counts_them() -> None:
    (panel,) = panels(curriculum(run([0.5], **reporting(level_probability=[0.2, 0.8]))))
    assert panel.get_ylabel() == "level, by number"
    assert ticks(panel) == ["0", "1"]


@pytest.mark.parametrize(
    ("size", "first", "last", "count"),
    [(1, "none", "0", 2), (2, "none", "0 1", 4), (5, "none", "0 1 2 3 4", 16)],
)
def test_rows_of_masks_are_named_by_what_they_keep(
    size: int, first: str, last: str, count: int
) -> None:
    (panel,) = panels(curriculum(run([0.5], **reporting(mask_probability=[0.1] * 2**size))))
    assert (ticks(panel)[0], ticks(panel)[-1], len(ticks(panel))) == (first, last, count)
    assert panel.get_ylabel() == "kept dimensions"


def test_a_number_is_a_line_per_setting_and_each_curriculum_has_its_panels() -> None:
    rows = sweep(
        lambda **_: [0.5, 0.5],
        shared=reporting(alpha=lambda epoch: epoch / 10, cutoff=lambda epoch: None),
        batch_size=[16, 32],
        curriculum=["mega"],
    )
    rows += sweep(lambda **_: [0.5, 0.5], shared=reporting(share=0.3), curriculum=["goid"])
    figure = curriculum(rows)
    assert titles(figure) == ["reach, mega", "reach, mega", "reach, goid"]
    alpha, cutoff, share = panels(figure)
    assert legend(alpha) == legend(cutoff) == ["batch size 16", "batch size 32"]
    assert heights(alpha, "batch size 32") == [0.1, 0.2]
    assert np.isnan(heights(cutoff, "batch size 32")).all()
    assert heights(share, "median of 2 runs") == [0.3, 0.3]
    assert [panel.get_ylabel() for panel in (alpha, cutoff, share)] == ["alpha", "cutoff", "share"]


def test_a_heat_map_is_the_mean_over_seeds_of_the_best_setting_which_it_names() -> None:
    rows = []
    for c_g, seed, rate in ((0.1, 0, 0.2), (0.1, 1, 0.4), (0.4, 0, 0.1), (0.4, 1, 0.1)):
        rows += run([rate], seed, c_g=c_g, **reporting(level_probability=[rate, None]))
    (panel,) = panels(curriculum(rows))
    np.testing.assert_allclose(heat_map(panel), [[0.3], [np.nan]])
    assert titles(curriculum(rows)) == [
        "reach, DDPG + HER, CGM, $c_g$ = 10 %, $\\kappa$ = 32, mean of 2 runs"
    ]


def test_numbers_and_heat_maps_end_where_the_first_of_the_seeds_did() -> None:
    rows = []
    for seed, epochs, value in ((0, 3, 1.0), (1, 3, 1.0), (2, 10, 0.4)):
        rows += run([0.5] * epochs, seed, **reporting(alpha=value, level_probability=[value]))
    alpha, levels = panels(curriculum(rows))
    assert heights(alpha, "median of 3 runs") == [1.0] * 3
    np.testing.assert_allclose(heat_map(levels), [[0.8] * 3])


def test_an_array_that_comes_after_the_first_seed_ended_says_so() -> None:
    late = reporting(level_probability=lambda epoch: [0.5] if epoch > 2 else None)
    rows = [*run([0.9, 0.9], 0, **late), *run([0.1] * 4, 1, **late)]
    (panel,) = panels(curriculum(rows))
    assert [text.get_text() for text in panel.texts] == [
        "level_probability: no value while all runs trained"
    ]


def test_an_array_without_any_value_says_so() -> None:
    (panel,) = panels(curriculum(run([0.5], **reporting(level_progress=[None, None]))))
    assert [text.get_text() for text in panel.texts] == [
        "level_progress: no value while all runs trained"
    ]


def test_curricula_that_report_nothing_have_no_figure() -> None:
    with pytest.raises(NothingToDraw, match="its curricula report nothing"):
        curriculum(run([0.5], curriculum="full"))


def test_an_array_is_flattened_once_for_each_row(monkeypatch: pytest.MonkeyPatch) -> None:
    module, calls = importlib.import_module("cgm_jax.results.figures.curriculum"), []
    flat = module._flat
    monkeypatch.setattr(module, "_flat", lambda value: calls.append(1) or flat(value))
    panels(curriculum(run([0.5] * 3, **reporting(gain=[[0.5] * 8] * 4))))
    assert len(calls) == 3
