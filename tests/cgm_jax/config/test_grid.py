import dataclasses
from typing import Any

import pytest

from cgm_jax.config.fields import SettingError, check
from cgm_jax.config.grid import STATIC, build_groups, split
from cgm_jax.config.presets import PRESETS
from cgm_jax.config.settings import Hyperparameters


def names(options: dict[str, list[Any]]) -> list[str]:
    (group,) = build_groups("smoke", options)
    return [run.name for run in group.runs]


def test_a_grid_is_the_product_of_its_axes() -> None:
    (group,) = build_groups("smoke", {"c_g": [0.0, 0.1, 0.4], "kappa": [4.0, 32.0], "seed": [0, 1]})
    values = [(run.hyper.c_g, run.hyper.kappa, run.hyper.seed) for run in group.runs]
    assert len(values) == len(set(values)) == 12
    assert len({run.name for run in group.runs}) == 12
    assert (0.4, 4.0, 1) in values


def test_runs_that_differ_only_in_what_has_no_effect_are_trained_once() -> None:
    both = names({"cgm": [True, False], "c_g": [0.1, 0.4], "kappa": [32.0]})
    assert both == [
        "reach_her_cgm-cg0.1-kappa32_seed0",
        "reach_her_full_seed0",
        "reach_her_cgm-cg0.4-kappa32_seed0",
    ]
    no_her = names({"her": [False], "her_k": [4.0, 6.0], "kappa": [32.0]})
    assert no_her == ["reach_ddpg_cgm-cg0.1-kappa32_seed0"]


def test_values_that_differ_in_the_eighth_digit_are_two_runs() -> None:
    assert len(names({"c_g": [0.1, 0.10000001], "kappa": [32.0]})) == 2


def test_environments_whose_runs_would_share_names_are_refused() -> None:
    with pytest.raises(SettingError, match="env: two environments would give their runs"):
        build_groups("smoke", {"env": ["a/mine.py:Task", "b/mine.py:Task"]})


def test_every_traced_setting_can_be_an_axis_and_names_its_runs() -> None:
    for item in dataclasses.fields(Hyperparameters):
        values = [True, False] if isinstance(item.default, bool) else [0, 0.25]
        values = [3, 4] if type(item.default) is int else values
        assert len(names({"kappa": [32.0], item.name: values})) == 2, item.name


def test_masks_drawn_uniformly_make_one_run_whatever_the_rates() -> None:
    options = {"kappa": [0.0], "c_g": [0.1, 0.4], "factorised": [True, False]}
    assert len(names(options)) == 1
    assert len(names({**options, "kappa": [1.0]})) == 4


@pytest.mark.parametrize("name", [name for name in STATIC if name != "env"])
def test_every_static_setting_refuses_to_be_an_axis_by_name(name: str) -> None:
    with pytest.raises(SettingError, match=f"^{name}: is static"):
        build_groups("smoke", {name: [1, 2]})


def test_environments_become_groups_with_the_papers_settings_for_each() -> None:
    push, pick = build_groups("paper", {})
    assert [group.settings.env for group in (push, pick)] == ["push", "pick_and_place"]
    assert [group.settings.environments for group in (push, pick)] == [16, 64]
    assert [group.settings.batch_size for group in (push, pick)] == [1024, 4096]
    for group in (push, pick):
        points = {(run.hyper.c_g, run.hyper.kappa, run.hyper.her) for run in group.runs}
        assert len(points) == 18 * 2
        assert len(group.runs) == 18 * 2 * 5
    for group, env_steps in ((push, 51_200), (pick, 204_800)):
        assert group.settings.cycles_per_epoch * group.settings.environments * 50 == env_steps


@pytest.mark.parametrize(
    ("largest", "sizes"), [(7, [7]), (6, [4, 3]), (3, [3, 2, 2]), (1, [1] * 7)]
)
def test_groups_split_evenly_and_lose_no_run(largest: int, sizes: list[int]) -> None:
    (group,) = build_groups("smoke", {"seed": list(range(7)), "kappa": [1.0]})
    parts = split(group, largest)
    assert [len(part.runs) for part in parts] == sizes
    assert [run for part in parts for run in part.runs] == list(group.runs)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"c_g": [1.5]}, "c_g: 1.5 is not within"),
        ({"c_g": [-0.1]}, "c_g: -0.1 is not within"),
        ({"kappa": [float("nan")]}, "kappa: nan is not a finite number"),
        ({"kappa": [float("inf")]}, "kappa: inf is not a finite number"),
        ({"c_g": []}, "c_g: needs at least one value"),
        ({"c_g": [0.1, 0.1]}, "c_g: holds a value twice"),
        ({"batch_size": [0]}, "batch_size: 0 is not within"),
        ({"hidden_layers": [()]}, "hidden_layers: needs at least one value"),
        ({"hidden_layers": [(64, 0)]}, "hidden_layers: 0 is not within"),
        ({"seed": [-1]}, "seed: -1 is not within"),
        ({"env": []}, "env: needs at least one value"),
        ({"actor_update_every": [3]}, "actor_update_every: 3 does not divide updates_per_cycle, 4"),
    ],
)
def test_bad_values_are_refused_by_name(options: dict[str, list[Any]], message: str) -> None:
    with pytest.raises(SettingError, match=message):
        build_groups("smoke", options)


def test_presets_name_only_settings_and_their_values_are_valid() -> None:
    for preset in PRESETS:
        for group in build_groups(preset, {}):
            for run in group.runs:
                check(run.hyper)
