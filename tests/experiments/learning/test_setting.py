from typing import Any

import pytest

from experiments.learning.records import settings_from
from experiments.learning.setting import USUAL_LAYERS, setting_of


def setting(**settings: Any) -> Any:
    usual = {"her_filter": True, "hidden_layers": USUAL_LAYERS}
    return setting_of(settings_from({**usual, **settings}))


@pytest.mark.parametrize(
    ("settings", "curriculum"),
    [
        ({}, "CGM (10 %, 32)"),
        ({"c_g": 0.4, "kappa": 4.0}, "CGM (40 %, 4)"),
        ({"curriculum": "full"}, "no masks"),
        ({"curriculum": "uniform"}, "uniform masks"),
        ({"factorised": False}, "CGM, joint rates (10 %, 32)"),
        ({"masked_evaluation_episodes": 3}, "CGM, masks measured (10 %, 32)"),
        ({"success_history": 50, "c_g": 0.8}, "CGM, h = 50 (80 %, 32)"),
        ({"full_share": 0.1}, "CGM, 10 % full goals (10 %, 32)"),
        ({"curriculum": "full", "critics": 3}, "no masks, three critics"),
    ],
)
def test_a_setting_tells_where_masks_come_from(settings: dict[str, Any], curriculum: str) -> None:
    assert setting(**settings).curriculum == curriculum


def test_hindsight_from_all_episodes_is_another_algorithm_unless_there_is_none() -> None:
    assert setting(her_filter=False).algorithm != setting().algorithm
    assert setting(her=False, her_filter=False) == setting(her=False)


@pytest.mark.parametrize(
    ("settings", "algorithm"),
    [
        ({"her": False, "her_masks": True}, "DDPG"),
        ({"her_masks": True}, "DDPG + HER (masked hindsight)"),
        ({"mask_input": True}, "DDPG + HER (mask as input)"),
        (
            {"relabelling": "relay", "relay_chance": 0.5, "relay_share": 0.15},
            "DDPG + HER (stages by 50 %, 15 % of hindsight)",
        ),
        (
            {"mask_input": True, "her_masks": True, "her_filter": False},
            "DDPG + HER (from all episodes, masked hindsight, mask as input)",
        ),
    ],
)
def test_what_networks_see_is_a_part_of_what_learns(
    settings: dict[str, Any], algorithm: str
) -> None:
    other = setting(**settings)
    assert other.algorithm == algorithm
    assert not other.differs_in_masks_alone(setting(curriculum="full"))
    assert other.differs_in_learning_alone(setting()) == (
        settings.get("her", True) and settings.get("her_filter", True)
    )


def test_other_networks_are_another_setting() -> None:
    wide = setting(hidden_layers=(256, 256, 256))
    assert wide.algorithm == "DDPG + HER (256 x 256 x 256)"
    assert not wide.differs_in_masks_alone(setting(curriculum="full"))
    assert not wide.differs_in_learning_alone(setting())


def test_goals_on_the_table_are_another_task() -> None:
    half = setting(env="pick_and_place", air_probability=0.5)
    assert half.task == "pick-and-place, 50 % in the air"
    whole = setting(env="pick_and_place")
    assert whole == setting(env="pick_and_place", air_probability=1.0) != half
    assert whole.task == "pick-and-place"
    assert setting(env="/a/b/sliders.py:Sliders").task == "sliders"


def test_random_actions_that_last_are_another_setting() -> None:
    one, five = setting(random_action_steps=1), setting(random_action_steps=5)
    assert one != five
    assert not one.differs_in_masks_alone(five)
    assert one.differs_in_masks_alone(setting(random_action_steps=1, curriculum="full"))
    assert not one.differs_in_masks_alone(one)


def test_the_same_on_another_engine_is_no_comparison_of_masks_or_learning() -> None:
    other = setting(engine="mjx")
    assert other.algorithm == "DDPG + HER (on mjx)"
    assert not other.differs_in_masks_alone(setting())
    assert not other.differs_in_learning_alone(setting())
