from typing import Any

import numpy as np
import pytest

from cgm_jax.results.figures import NothingToDraw, mask_label, mask_success
from tests.cgm_jax.results.figures.made import (
    heights,
    legend,
    legend_of,
    panels,
    run,
    sweep,
    titles,
)


def masked(size: int) -> dict[str, Any]:
    """Mask m succeeds with m / 2^n; in training only where an odd number of epochs is done."""
    rates = [mask / 2**size for mask in range(2**size)]
    return {
        "mask_rate_estimated": rates,
        "mask_rate_training": lambda epoch: rates if epoch % 2 else [None] * 2**size,
    }


@pytest.mark.parametrize(
    ("size", "kept"),
    [
        (1, ["none", "0"]),
        (2, ["none", "1", "0", "0 1"]),
        (3, ["none", "z", "y", "y z", "x", "x z", "x y", "x y z"]),
        (5, ["0", "1", "2", "3", "4", "0 1 2 3 4"]),
    ],
)
def test_masks_of_goals_of_any_size_are_told_by_what_they_keep(size: int, kept: list[str]) -> None:
    estimated, training = panels(mask_success(run([0.5, 0.5, 0.5], **masked(size))))
    for panel in (estimated, training):
        assert legend(panel) == kept
    title = legend_of(estimated).get_title().get_text()
    assert title == ("kept dimensions\n(6 of 32 masks)" if size == 5 else "kept dimensions")
    full = (2**size - 1) / 2**size
    assert heights(estimated, kept[-1]) == [full] * 3
    np.testing.assert_equal(heights(training, kept[-1]), [full, np.nan, full])


def test_a_pair_of_panels_shows_the_best_setting_of_a_curriculum() -> None:
    rows = sweep(
        lambda c_g, batch_size, seed: [c_g], shared=masked(3), c_g=[0.1, 0.4], batch_size=[16, 32]
    )
    rows += sweep(
        lambda **_: [0.3],
        shared={**masked(3), "mask_rate_estimated": None},
        curriculum=["uniform"],
        batch_size=[16],
    )
    figure = mask_success(rows)
    assert titles(figure)[::2] == [
        "reach, DDPG + HER, CGM, $c_g$ = 40 %, $\\kappa$ = 32, batch size 16",
        "reach, DDPG + HER, uniform, batch size 16",
    ]
    assert [len(legend(panel)) for panel in panels(figure)] == [8, 8, 0, 8]
    assert [text.get_text() for text in panels(figure)[2].texts] == [
        "no value while all runs trained"
    ]


def test_a_setting_that_left_early_with_success_is_the_best() -> None:
    rows = run([0.0, 0.2, 0.5, 0.6, 0.6], c_g=0.1, **masked(2))
    rows += run([0.0, 0.1, *[0.45] * 58], c_g=0.4, **masked(2))
    assert "$c_g$ = 10 %" in titles(mask_success(rows))[0]


def test_lines_end_where_the_first_of_the_seeds_did() -> None:
    rows = [*run([0.5] * 3, 0, **masked(2)), *run([0.5] * 3, 1, **masked(2))]
    rows += run([0.1] * 10, 2, **masked(2))
    estimated, training = panels(mask_success(rows))
    assert heights(estimated, "0 1") == [0.75] * 3
    np.testing.assert_equal(heights(training, "0 1"), [0.75, np.nan, 0.75])


def test_masks_that_were_never_drawn_have_no_line() -> None:
    rates = {**masked(3), "mask_rate_training": [None] * 7 + [0.2]}
    estimated, training = panels(mask_success(run([0.5, 0.5], **rates)))
    assert len(legend(estimated)) == 8
    assert legend(training) == ["x y z"]


def test_a_run_without_any_valid_episode_is_named() -> None:
    assert titles(mask_success(run([None], **masked(2))))[0].endswith(", no valid episode")


@pytest.mark.parametrize("training", [None, [None] * 7 + [0.5]])
def test_without_masks_there_is_no_figure(training: list[float] | None) -> None:
    with pytest.raises(NothingToDraw, match="no run drew masks"):
        mask_success(run([0.5], curriculum="full", mask_rate_training=training))


@pytest.mark.parametrize(
    ("mask", "size", "label"),
    [(0, 3, "none"), (7, 3, "x y z"), (4, 3, "x"), (5, 3, "x z"), (1, 2, "1"), (9, 5, "1 4")],
)
def test_mask_labels_name_the_kept_axes(mask: int, size: int, label: str) -> None:
    assert mask_label(mask, size) == label
