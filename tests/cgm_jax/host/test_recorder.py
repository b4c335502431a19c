"""What a row of metrics.jsonl says of its run."""

from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from cgm_jax.config.grid import Group, build_groups, swept_settings
from cgm_jax.config.sizes import Sizes
from cgm_jax.host import recorder
from cgm_jax.host.checkpoint import TrainingProgress
from cgm_jax.results.figures import learning_curves
from tests.cgm_jax.results.figures.made import legend, panels, titles

EXAMPLES = Path(__file__).parents[2] / "examples"
SIZES = Sizes(
    **dict.fromkeys(("observation", "inputs", "episode_length", "environments"), 4),
    **dict.fromkeys(("evaluation_episodes", "updates_at_once", "critics"), 1),
    goal=2,
    action=2,
    distance_threshold=0.1,
    starts=None,
)


class State:
    """As much of a training state as rows take."""

    agent = None

    def __init__(self, curriculum: Any) -> None:
        self.curriculum = curriculum


def rows_of(groups: list[Group]) -> list[dict[str, Any]]:
    """The first epoch's rows of a sweep in which every run succeeds half of the time."""
    swept = swept_settings(groups)
    return [row for group in groups for row in _rows_of(group, swept, _progress(group))]


def _progress(group: Group) -> TrainingProgress:
    state = group.runs[0].hyper.curriculum.init(SIZES)
    stacked = State(jax.tree.map(lambda leaf: jnp.stack([leaf] * len(group.runs)), state))
    return TrainingProgress(stacked, epoch=1)  # pyright: ignore[reportArgumentType]


def _rows_of(
    group: Group, swept: list[str], training: TrainingProgress, **counts: np.ndarray
) -> list[dict[str, Any]]:
    runs = len(group.runs)
    curriculum = group.runs[0].hyper.curriculum
    reported = curriculum.report(curriculum.init(SIZES))
    counts = {"updates": np.ones(runs, int), "failure": np.zeros(runs, int), **counts}
    metrics = {"env_steps": np.full(runs, 100), "success_rate": np.full(runs, 0.5), **counts}
    metrics |= {name: np.stack([value] * runs) for name, value in reported.items()}
    facts = [recorder._facts(run, swept) for run in group.runs]
    return recorder._rows(group, facts, training, metrics)  # pyright: ignore[reportArgumentType]


def test_a_run_keeps_the_epoch_in_which_it_diverged(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(recorder, "describe_failure", lambda *_: "critic")
    (group,) = build_groups("smoke", {"c_g": [0.1], "kappa": [4.0, 32.0], "curriculum": ["cgm"]})
    training, told = _progress(group), []
    for training.epoch in (1, 2, 3):
        # No update was counted before: cycles without a valid episode have none.
        failed = np.array([0, training.epoch > 1], int)
        training.rows += _rows_of(group, [], training, updates=np.zeros(2, int), failure=failed)
        told.append([row["failed_epoch"] for row in training.rows[-2:]])
    assert told == [[None, None], [None, 2], [None, 2]]


def test_rows_tell_every_swept_setting_whatever_group_they_are_of() -> None:
    options = {
        "curriculum": ["cgm", "full", "uniform"],
        "hidden_layers": [(8,), (8, 16)],
        "leave_at": [None, 0.9],
        "kappa": [4.0],
    }
    rows = rows_of(build_groups("smoke", options))
    assert len(rows) == 12
    assert len({tuple(row) for row in rows}) == 1  # the same keys in the same order
    swept = ["leave_at", "curriculum", "hidden_layers"]
    for row in rows:
        assert sorted(row["swept"]) == sorted(swept)
        assert set(swept) <= set(row)
        assert (row["c_g"], row["kappa"]) == ((0.1, 4) if row["cgm"] else (None, None))
    told = {(row["curriculum"], str(row["hidden_layers"]), row["leave_at"]) for row in rows}
    assert told == {
        (curriculum, layers, leave_at)
        for curriculum in ("cgm", "full", "uniform")
        for layers in ("[8]", "[8, 16]")
        for leave_at in (None, 0.9)
    }


def test_a_swept_setting_is_null_where_it_has_no_effect_or_there_is_none() -> None:
    options = {"her": [True, False], "her_k": [1.0, 4.0], "kappa": [4.0]}
    rows = rows_of(build_groups("smoke", options))
    assert [(row["her"], row["her_k"]) for row in rows] == [(True, 1), (True, 4), (False, None)]
    options = {"curriculum": ["cgm", "full"], "full_share": [0.0, 0.5], "kappa": [4.0]}
    rows = rows_of(build_groups("smoke", options))
    assert [row["full_share"] for row in rows] == [0.0, 0.5, None]


WIDE = """
from cgm_jax.agents.ddpg import DDPG
from cgm_jax.config.fields import settings, static

@settings
class Wide(DDPG):
    widths: tuple[int, ...] = static((8,), "of nothing", 1, 100)
"""


def test_rows_tell_the_swept_settings_of_the_users_own_components(tmp_path: Path) -> None:
    (tmp_path / "wide.py").write_text(WIDE)
    growing = f"{EXAMPLES / 'my_curriculum.py'}:Growing"
    options = {
        "agent": [f"{tmp_path / 'wide.py'}:Wide", "ddpg"],
        "curriculum": [growing, "full"],
        "widths": [(8, 16), (32,)],
        "gain": [0.5, 0.25],
        "actor_learning_rate": [1e-3, 1e-4],
        "her": [False],
    }
    rows = rows_of(build_groups("smoke", options))
    told = {
        (row["curriculum"], row["gain"], str(row["widths"]), row["actor_learning_rate"])
        for row in rows
    }
    assert told == {
        (curriculum, gain, widths, rate)
        for curriculum, gain in ((growing, 0.5), (growing, 0.25), ("full", None))
        for widths in ("[8, 16]", "[32]", "None")  # of the other agent
        for rate in (1e-3, 1e-4)
    }
    assert len(rows) == len(told)


def test_rows_say_what_their_curriculum_reports() -> None:
    cgm, full = rows_of(build_groups("smoke", {"curriculum": ["cgm", "full"], "kappa": [4.0]}))
    assert cgm["reported"] == ["mask_probability", "mask_rate_estimated"]
    assert len(cgm["mask_probability"]) == 4
    assert full["reported"] == []
    assert full["mask_probability"] is None


def test_what_a_sweep_varies_is_told_by_its_figures() -> None:
    options = {"batch_size": [16, 32], "curriculum": ["cgm", "full"], "kappa": [4.0]}
    figure = learning_curves(rows_of(build_groups("smoke", options)))
    assert [title[-13:] for title in titles(figure)] == ["batch size 16", "batch size 32"]
    assert [legend(panel) for panel in panels(figure)] == [["CGM", "no CGM (full)"]] * 2
