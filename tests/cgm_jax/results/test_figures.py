from typing import Any

import numpy as np
import pytest

from cgm_jax.results.figures import epochs_to_half, learning_curves, mask_label, mask_success


def rows() -> list[dict[str, Any]]:
    """Three seeds each of c_g 0.1 (50 % held at 3, 3 and never) and 0.8 (never), and no CGM."""
    curves = {
        (0.1, True): [[0.4, 0.6, 0.9, 0.9], [0.3, 0.6, 0.6, 0.7], [0.0, 0.0, 0.1, 0.2]],
        (0.8, True): [[0.0, 0.1, 0.2, 0.3]] * 3,
        (0.0, False): [[0.3, 0.5, 0.5, 0.5]] * 3,
    }
    return [
        {
            "run": f"reach_her_{'cgm-' if cgm else 'full'}{c_g}_seed{seed}",
            "env": "reach",
            "her": True,
            "cgm": cgm,
            "c_g": c_g,
            "kappa": 32.0,
            "seed": seed,
            "epoch": epoch + 1,
            "env_steps": 1000 * (epoch + 1),
            "success_rate": rate,
            "mask_rate_estimated": [rate] * 8,
            "mask_rate_training": [None] * 7 + [rate],
        }
        for (c_g, cgm), runs in curves.items()
        for seed, curve in enumerate(runs)
        for epoch, rate in enumerate(curve)
    ]


def line(panel: Any, label: str) -> np.ndarray:
    (found,) = [one for one in panel.get_lines() if one.get_label() == label]
    return np.array(found.get_xydata())


def test_epochs_to_half_shows_medians_over_seeds_and_the_baseline() -> None:
    (panel,) = epochs_to_half(rows()).axes
    # Unreached runs stand at the last epoch; the median of (3, 3, never) is 3.
    np.testing.assert_allclose(line(panel, "$\\kappa$ = 32"), [[10, 3], [80, 4]])
    assert line(panel, "no CGM")[:, 1].tolist() == [4, 4]
    assert panel.get_xlabel() == "target success rate $c_g$ (%)"
    assert panel.get_ylabel() == "epochs to 50 % success"
    assert [text.get_text() for text in panel.texts] == [
        *("not within 4 epochs (open)", "an epoch: 1,000 env_steps")
    ]


def test_epochs_to_half_marks_no_end_where_all_medians_get_there() -> None:
    (panel,) = epochs_to_half([row for row in rows() if row["c_g"] == 0.1]).axes
    assert [text.get_text() for text in panel.texts] == ["an epoch: 1,000 env_steps"]


def test_learning_curves_show_medians_over_seeds() -> None:
    (panel,) = learning_curves(rows()).axes
    expected = np.column_stack([[1000, 2000, 3000, 4000], [0.3, 0.6, 0.6, 0.7]])
    np.testing.assert_allclose(line(panel, "$c_g$ = 10 %"), expected)
    np.testing.assert_allclose(line(panel, "no CGM")[:, 1], [0.3, 0.5, 0.5, 0.5])


def test_a_run_that_diverged_is_marked_where_it_did() -> None:
    diverged = [
        {**row, "failed_epoch": 2 if row["c_g"] == 0.1 and row["seed"] == 1 else None}
        for row in rows()
    ]
    (panel,) = learning_curves(diverged).axes
    (cross,) = [one for one in panel.get_lines() if one.get_marker() == "x"]
    np.testing.assert_allclose(np.array(cross.get_xydata()), [[2000, 0.6]])
    np.testing.assert_allclose(line(panel, "$c_g$ = 10 % (1 diverged)")[:, 1], [0.3, 0.6, 0.6, 0.7])
    (panel,) = epochs_to_half(diverged).axes
    assert len(line(panel, "$\\kappa$ = 32 (1 diverged)")) == 2


def test_uniform_masks_are_not_taken_for_no_curriculum() -> None:
    uniform = [{**row, "kappa": 0.0} if row["cgm"] else row for row in rows()]
    (panel,) = learning_curves(uniform).axes
    assert panel.get_title() == "reach, DDPG + HER, $\\kappa$ = 0"
    assert line(panel, "no CGM")[:, 1].tolist() == [0.3, 0.5, 0.5, 0.5]
    assert line(panel, "$c_g$ = 10 %")[-1, 1] == 0.7


def test_further_axes_appear_in_the_legend_also_for_environments_from_files() -> None:
    mine = [
        {
            **row,
            "run": f"point_mass-PointMass_her_cgm-cg0.1-kappa32_herk{k}_seed{row['seed']}",
            "env": "/a/point_mass.py:PointMass",
        }
        for row in rows()
        if row["c_g"] == 0.1
        for k in (1, 4)
    ]
    (panel,) = learning_curves(mine).axes
    labels = [one.get_label() for one in panel.get_lines()]
    assert labels[:2] == ["$c_g$ = 10 %, herk1", "$c_g$ = 10 %, herk4"]


def test_masks_that_were_never_sampled_have_no_line() -> None:
    estimated, training = mask_success(rows()).axes
    assert len(estimated.get_lines()) == 8
    assert [one.get_label() for one in training.get_lines()] == ["x y z"]
    assert "10 %" in training.get_title()  # the better setting


@pytest.mark.parametrize(
    ("mask", "size", "label"),
    [(0, 3, "none"), (7, 3, "x y z"), (4, 3, "x"), (5, 3, "x z"), (1, 2, "2")],
)
def test_mask_labels_name_the_kept_axes(mask: int, size: int, label: str) -> None:
    assert mask_label(mask, size) == label
