from typing import Any

import numpy as np
import pytest

from cgm_jax.results.figures import NothingToDraw, epochs_to_half
from tests.cgm_jax.results.figures.made import legend, line, panels, points, run, sweep, titles

NEVER = [0.0, 0.1, 0.2, 0.3]
AT_3 = [0.4, 0.6, 0.9, 0.9]


def of_c_g(c_g: float, seed: int, **_: Any) -> list[float]:
    """Three seeds each of c_g 0.1 (50 % held at 3, 3 and never) and 0.8 (never)."""
    return AT_3 if c_g == 0.1 and seed < 2 else NEVER


def texts(panel: Any) -> list[str]:
    return [text.get_text() for text in panel.texts]


def test_medians_over_seeds_stand_over_c_g_and_the_baseline_is_a_level_line() -> None:
    rows = sweep(of_c_g, seeds=3, c_g=[0.1, 0.8])
    rows += sweep(lambda **_: [0.3, 0.5, 0.5, 0.5], seeds=3, curriculum=["full"])
    (panel,) = panels(epochs_to_half(rows))
    # Unreached runs stand at the last epoch; the median of (3, 3, never) is 3.
    np.testing.assert_allclose(points(panel, "CGM"), [[10, 3], [80, 4]])
    assert points(panel, "no CGM (full)")[:, 1].tolist() == [4, 4]
    assert line(panel, "no CGM (full)").get_color() == "black"
    open_points = [one for one in panel.get_lines() if one.get_markerfacecolor() == "white"]
    assert np.array(open_points[0].get_xydata()).tolist() == [[80, 4]]
    assert panel.get_xlabel() == "target success rate $c_g$ (%)"
    assert panel.get_ylabel() == "epochs to 50 % success"
    assert texts(panel) == ["not within 4 epochs (open)", "an epoch: 1,000 env_steps"]


def test_an_open_point_stands_no_later_than_the_median_run_was_trained() -> None:
    """Two of three seeds left at epoch 4: nothing is known of the median after it."""
    rates = {0: [0.3] * 4, 1: [0.3] * 4, 2: [0.3] * 60}
    (panel,) = panels(epochs_to_half(sweep(lambda seed, **_: rates[seed], seeds=3, c_g=[0.1, 0.4])))
    assert points(panel, "median over seeds").tolist() == [[10, 4], [40, 4]]
    assert texts(panel)[0] == "not within 4 epochs (open)"
    # One left, one held 50 % at 5, one never did in 60: the median run did not within 4.
    rates = {0: [0.3] * 4, 1: [0.3, 0.3, 0.5, 0.5, 0.5], 2: [0.3] * 60}
    (panel,) = panels(epochs_to_half(sweep(lambda seed, **_: rates[seed], seeds=3, c_g=[0.1, 0.4])))
    assert points(panel, "median over seeds").tolist() == [[10, 4], [40, 4]]


def test_no_end_is_marked_where_all_medians_get_there() -> None:
    (panel,) = panels(epochs_to_half(sweep(lambda **_: AT_3, c_g=[0.1, 0.2])))
    assert texts(panel) == ["an epoch: 1,000 env_steps"]
    assert legend(panel) == ["median over seeds"]


def test_kappa_is_lines_over_c_g_and_what_else_differs_panels() -> None:
    axes = {"c_g": [0.1, 0.8], "kappa": [4.0, 32.0], "batch_size": [16, 32]}
    figure = epochs_to_half(sweep(of_c_g, **axes))
    assert titles(figure) == [f"reach, DDPG + HER, CGM, batch size {size}" for size in (16, 32)]
    for panel in panels(figure):
        assert legend(panel) == ["$\\kappa$ = 4", "$\\kappa$ = 32"]
        assert points(panel, "$\\kappa$ = 4").tolist() == [[10, 3], [80, 4]]


def test_learning_rates_are_the_axis_where_they_alone_differ() -> None:
    rates = [1e-4, 1e-3, 1e-2]
    rows = sweep(
        lambda actor_learning_rate, seed: AT_3 if actor_learning_rate == 1e-3 else NEVER,
        actor_learning_rate=rates,
    )
    (panel,) = panels(epochs_to_half(rows))
    assert points(panel, "median over seeds").tolist() == [[1e-4, 4], [1e-3, 3], [1e-2, 4]]
    assert panel.get_xlabel() == "actor learning rate"
    assert panel.get_xscale() == "log"


def test_curricula_are_points_without_a_line_between_them() -> None:
    rows = sweep(
        lambda curriculum, seed: AT_3 if curriculum == "cgm" else NEVER,
        curriculum=["cgm", "full", "uniform"],
    )
    (panel,) = panels(epochs_to_half(rows))
    assert [text.get_text() for text in panel.get_xticklabels()] == [
        *("CGM", "no CGM (full)", "uniform")
    ]
    assert points(panel, "median over seeds").tolist() == [[0, 3], [1, 4], [2, 4]]
    assert line(panel, "median over seeds").get_linestyle() == "None"


def test_environment_steps_take_the_place_of_epochs_of_different_lengths() -> None:
    rows = sweep(lambda **_: AT_3, environments=[8, 16])
    for row in rows:
        row["env_steps"] = 100 * row["environments"] * row["epoch"]
    (panel,) = panels(epochs_to_half(rows))
    assert points(panel, "median over seeds").tolist() == [[8, 2400], [16, 4800]]
    assert panel.get_ylabel() == "env_steps to 50 % success"


def test_runs_of_different_lengths_stand_where_each_ended() -> None:
    rows = sweep(lambda c_g, seed: NEVER if c_g == 0.1 else [*NEVER, 0.3, 0.3], c_g=[0.1, 0.4])
    (panel,) = panels(epochs_to_half(rows))
    assert points(panel, "median over seeds").tolist() == [[10, 4], [40, 6]]
    assert texts(panel)[0] == "not within the training (open)"


def test_open_points_stand_where_their_own_training_ended() -> None:
    rows = sweep(lambda c_g, seed: NEVER if c_g == 0.1 else [*AT_3, 0.9, 0.9], c_g=[0.1, 0.4])
    (panel,) = panels(epochs_to_half(rows))
    assert points(panel, "median over seeds").tolist() == [[10, 4], [40, 3]]
    assert texts(panel)[0] == "not within 4 epochs (open)"


def test_runs_that_diverged_or_had_no_valid_episode_are_named() -> None:
    rows = sweep(lambda c_g, seed: AT_3 if seed else [None] * 4, c_g=[0.1])
    rows += sweep(lambda **_: NEVER, shared={"failed_epoch": 2}, c_g=[0.4])
    (panel,) = panels(epochs_to_half(rows))
    assert legend(panel) == ["median over seeds (1 without valid episode, 2 diverged)"]


@pytest.mark.parametrize("axes", [{}, {"env": ["reach", "push"]}])
def test_where_nothing_could_be_an_axis_there_is_no_figure(axes: dict[str, Any]) -> None:
    with pytest.raises(NothingToDraw, match="differ in the seed and the environment at most"):
        epochs_to_half(sweep(lambda **_: AT_3, **axes))


def test_one_epoch_is_drawn_too_and_one_run_is_no_median() -> None:
    (panel,) = panels(epochs_to_half(run([0.9], c_g=0.1) + run([0.9], c_g=0.4)))
    assert legend(panel) == ["one run each"]
    assert texts(panel)[0] == "not within 1 epoch (open)"
