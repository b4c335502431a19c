from typing import Any

import numpy as np
import pytest
from matplotlib.collections import LineCollection
from matplotlib.colors import to_hex

from cgm_jax.results.figures import learning_curves
from tests.cgm_jax.results.figures.made import (
    heights,
    legend,
    legend_of,
    line,
    panels,
    points,
    run,
    sweep,
    titles,
)

NAN = np.nan


def constant(rate: float) -> Any:
    return lambda **_: [rate, rate]


def test_a_line_is_the_median_over_seeds_and_its_band_the_quartiles() -> None:
    rows = [row for seed, rate in enumerate((0.0, 0.4, 0.6)) for row in run([rate, 1.0], seed)]
    (panel,) = panels(learning_curves(rows))
    assert points(panel, "median of 3 runs").tolist() == [[1000, 0.4], [2000, 1.0]]
    band = panel.collections[0].get_paths()[0].vertices
    assert sorted({y for x, y in np.asarray(band) if x == 1000}) == pytest.approx([0.2, 0.5])
    assert panel.get_title() == "reach, DDPG + HER, CGM, $c_g$ = 10 %, $\\kappa$ = 32"


def test_a_sweep_of_c_g_and_kappa_is_lines_and_panels_and_the_baseline_in_each() -> None:
    rows = sweep(lambda c_g, kappa, seed: [c_g, kappa / 100], c_g=[0.1, 0.4], kappa=[4.0, 32.0])
    rows += sweep(constant(0.9), curriculum=["full"])
    figure = learning_curves(rows)
    assert titles(figure) == [f"reach, DDPG + HER, $\\kappa$ = {kappa}" for kappa in (4, 32)]
    for panel, kappa in zip(panels(figure), (0.04, 0.32), strict=True):
        assert legend(panel) == ["$c_g$ = 10 %", "$c_g$ = 40 %", "no CGM (full)"]
        assert heights(panel, "$c_g$ = 40 %") == [0.4, kappa]
        assert heights(panel, "no CGM (full)") == [0.9, 0.9]
        assert line(panel, "no CGM (full)").get_color() == "black"
        colours = [to_hex(line(panel, f"$c_g$ = {rate} %").get_color()) for rate in (10, 40)]
        assert colours[0] != colours[1]


def test_a_baseline_appears_only_with_runs_whose_other_settings_it_shares() -> None:
    rows = sweep(constant(0.5), batch_size=[16, 32], kappa=[4.0, 32.0])
    rows += sweep(constant(0.9), curriculum=["full"], batch_size=[32])
    figure = learning_curves(rows)
    curricula = {
        title.partition("+ HER, ")[2]: legend(panel)
        for title, panel in zip(titles(figure), panels(figure), strict=True)
    }
    assert curricula == {
        f"$c_g$ = 10 %, $\\kappa$ = {kappa}, batch size {size}": ["CGM", "no CGM (full)"][:lines]
        for kappa in (4, 32)
        for size, lines in ((16, 1), (32, 2))
    }


def test_learning_rates_are_not_pooled() -> None:
    rows = sweep(
        lambda actor_learning_rate, seed: [actor_learning_rate] * 2,
        actor_learning_rate=[1e-4, 1e-3],
    )
    (panel,) = panels(learning_curves(rows))
    assert legend(panel) == ["actor learning rate 0.0001", "actor learning rate 0.001"]
    assert heights(panel, "actor learning rate 0.001") == [1e-3, 1e-3]


def test_two_further_settings_are_told_by_panels() -> None:
    axes = {"hidden_layers": [[64], [64, 64]], "batch_size": [16, 32], "c_g": [0.1, 0.4]}
    assert titles(learning_curves(sweep(constant(0.5), seeds=1, **axes))) == [
        f"reach, DDPG + HER, CGM, $\\kappa$ = 32, hidden layers {layers}, batch size {size}"
        for layers in ("64", "64x64")
        for size in (16, 32)
    ]


def test_curricula_are_lines_of_which_the_one_without_masks_is_black() -> None:
    rows = sweep(
        lambda curriculum, batch_size, seed: [len(curriculum) / 10] * 2,
        curriculum=["cgm", "full", "uniform"],
        batch_size=[16, 32],
    )
    figure = learning_curves(rows)
    assert [title[-13:] for title in titles(figure)] == ["batch size 16", "batch size 32"]
    for panel in panels(figure):
        assert legend(panel) == ["CGM", "no CGM (full)", "uniform"]
        assert heights(panel, "uniform") == [0.7, 0.7]
        colours = [to_hex(line(panel, label).get_color()) for label in legend(panel)]
        assert colours[1] == "#000000"
        assert len(set(colours)) == 3


def test_null_that_is_a_value_is_one_of_its_setting() -> None:
    rows = sweep(lambda leave_at, seed: [leave_at or 0.1] * 2, leave_at=[None, 0.5, 0.9])
    (panel,) = panels(learning_curves(rows))
    assert legend(panel) == ["leave at 0.5", "leave at 0.9", "leave at none"]
    assert heights(panel, "leave at none") == [0.1, 0.1]


def test_so_many_settings_that_panels_would_be_too_many_are_told_by_lines() -> None:
    rows = sweep(
        constant(0.5), seeds=1, batch_size=list(range(1, 14)), c_g=[0.1, 0.4], her=[True, False]
    )
    figure = learning_curves(rows)
    assert [title.partition(",")[2] for title in titles(figure)] == [
        f" DDPG{her}, CGM, $\\kappa$ = 32" for her in ("", " + HER")
    ]
    for panel in panels(figure):
        labels = [str(one.get_label()) for one in panel.get_lines()[:26]]
        assert len(set(labels)) == 26
        assert labels[13] == "$c_g$ = 40 %, batch size 1"
        looks = {(to_hex(one.get_color()), one.get_linestyle()) for one in panel.get_lines()[:26]}
        assert len(looks) == 26


@pytest.mark.parametrize("count", [13, 20, 22, 50])
def test_many_labels_stand_beside_the_panel(count: int) -> None:
    rows = sweep(lambda c_g, seed: [c_g, c_g], seeds=1, c_g=[i / 100 for i in range(count)])
    figure = learning_curves(rows)
    (panel,) = panels(figure)
    assert legend(panel) == [f"$c_g$ = {i} %" for i in range(count)]
    box = legend_of(panel).get_window_extent()
    assert box.x0 >= panel.get_window_extent().x1
    assert box.x1 <= figure.bbox.x1
    assert box.y0 >= figure.bbox.y0


def test_a_legend_of_very_many_lines_says_how_many_it_leaves_out() -> None:
    rows = sweep(lambda c_g, seed: [c_g], seeds=1, c_g=[i / 100 for i in range(70)])
    (panel,) = panels(learning_curves(rows))
    assert len(legend(panel)) == 60
    assert legend_of(panel).get_title().get_text() == "(and 10 more)"


def test_one_epoch_is_a_dot_with_its_quartiles() -> None:
    rows = [row for seed, rate in enumerate((0.2, 0.4, 0.8)) for row in run([rate], seed)]
    (panel,) = panels(learning_curves(rows))
    drawn = line(panel, "median of 3 runs")
    assert drawn.get_marker() == "o"
    assert drawn.get_markevery() == [0]
    (bars,) = [one for one in panel.collections if isinstance(one, LineCollection)]
    np.testing.assert_allclose(bars.get_segments()[0], [[1000, 0.3], [1000, 0.6]])
    assert panel.get_xlim()[0] == 0


def test_epochs_without_valid_episodes_break_the_line() -> None:
    (panel,) = panels(learning_curves(run([0.1, 0.2, None, 0.4, None, None, 0.7, 0.8])))
    drawn = line(panel, "1 run")
    np.testing.assert_equal(np.array(drawn.get_ydata()), [0.1, 0.2, NAN, 0.4, NAN, NAN, 0.7, 0.8])
    assert drawn.get_markevery() == [3]  # the one without neighbours


def test_a_run_without_any_valid_episode_is_named_and_its_neighbour_is_whole() -> None:
    rows = sweep(lambda c_g, seed: [None, None] if c_g == 0.1 else [0.3, 0.6], c_g=[0.1, 0.4])
    (panel,) = panels(learning_curves(rows))
    assert legend(panel) == ["$c_g$ = 10 % (no valid episode)", "$c_g$ = 40 %"]
    assert heights(panel, "$c_g$ = 40 %") == [0.3, 0.6]
    assert np.isnan(heights(panel, "$c_g$ = 10 % (no valid episode)")).all()


def test_some_runs_without_any_valid_episode_are_counted() -> None:
    (panel,) = panels(learning_curves(run([None, None]) + run([0.2, 0.4], seed=1)))
    assert legend(panel) == ["median of 2 runs (1 without valid episode)"]
    assert heights(panel, "median of 2 runs (1 without valid episode)") == [0.2, 0.4]


def test_a_run_that_diverged_is_marked_where_it_did() -> None:
    rows = run([0.3, 0.5, 0.5], failed_epoch=lambda epoch: 2 if epoch >= 2 else None)
    rows += run([0.3, 0.7, 0.9], seed=1)
    (panel,) = panels(learning_curves(rows))
    (cross,) = [one for one in panel.get_lines() if one.get_marker() == "x"]
    np.testing.assert_allclose(np.array(cross.get_xydata()), [[2000, 0.5]])
    np.testing.assert_allclose(heights(panel, "median of 2 runs (1 diverged)"), [0.3, 0.6, 0.7])


def test_a_median_ends_where_its_first_run_does_and_the_others_go_on_alone() -> None:
    rows = run([0.1, 0.2], seed=0) + run([0.3, 0.4, 0.9, 1.0], seed=1)
    (panel,) = panels(learning_curves(rows))
    np.testing.assert_allclose(points(panel, "median of 2 runs"), [[1000, 0.2], [2000, 0.3]])
    (alone,) = [one for one in panel.get_lines() if one.get_linewidth() == 0.6]
    np.testing.assert_allclose(
        np.array(alone.get_xydata()), [[2000, 0.4], [3000, 0.9], [4000, 1.0]]
    )


def test_environments_from_files_are_named_without_folders_and_not_taken_for_formulas() -> None:
    rows = sweep(constant(0.5), seeds=1, env=["/a/b/_my$env$.py:Point", "pick_and_place"])
    assert titles(learning_curves(rows)) == [
        "env _my\\$env\\$.py:Point, DDPG + HER, CGM, $c_g$ = 10 %, $\\kappa$ = 32",
        "pick-and-place, DDPG + HER, CGM, $c_g$ = 10 %, $\\kappa$ = 32",
    ]


def test_runs_that_differ_in_what_no_row_tells_are_refused() -> None:
    rows = run([0.5]) + [{**row, "run": "other"} for row in run([0.6])]
    with pytest.raises(ValueError, match="other have seed 0, and no row tells what else differs"):
        learning_curves(rows)


def test_rows_of_older_versions_are_read() -> None:
    rows = sweep(constant(0.5), c_g=[0.1, 0.4]) + sweep(constant(0.7), curriculum=["full"])
    known = ("curriculum", "agent", "swept", "reported")
    old = [{key: value for key, value in row.items() if key not in known} for row in rows]
    for row in old:
        row["c_g"], row["kappa"] = row["c_g"] or 0.1, 32.0
    (panel,) = panels(learning_curves(old))
    assert legend(panel) == ["$c_g$ = 10 %", "$c_g$ = 40 %", "no CGM (full)"]
    assert heights(panel, "no CGM (full)") == [0.7, 0.7]
