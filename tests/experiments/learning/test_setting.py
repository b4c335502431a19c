from typing import Any

import pytest

from experiments.learning.records import upgraded
from experiments.learning.setting import setting_of


def setting(**settings: Any) -> Any:
    return setting_of(upgraded({"her_filter": True, **settings}))


@pytest.mark.parametrize(
    ("settings", "curriculum"),
    [
        ({}, "CGM (10 %, 32)"),
        ({"c_g": 0.4, "kappa": 4.0}, "CGM (40 %, 4)"),
        ({"cgm": False, "kappa": 0.0}, "no masks"),
        ({"kappa": 0.0, "factorised": False}, "uniform masks"),
        ({"factorised": False}, "CGM, joint rates (10 %, 32)"),
        ({"masked_evaluation_episodes": 3}, "CGM, masks measured (10 %, 32)"),
    ],
)
def test_a_setting_tells_where_masks_come_from(settings: dict[str, Any], curriculum: str) -> None:
    assert setting(**settings).curriculum == curriculum


@pytest.mark.parametrize("masks", [{"cgm": False}, {"kappa": 0.0}])
def test_what_has_no_effect_on_masks_tells_no_settings_apart(masks: dict[str, Any]) -> None:
    assert setting(**masks, c_g=0.1) == setting(**masks, c_g=0.8) != setting()


def test_hindsight_from_all_episodes_is_another_algorithm_unless_there_is_none() -> None:
    assert setting(her_filter=False).algorithm != setting().algorithm
    assert setting(her=False, her_filter=False) == setting(her=False)


def test_random_actions_that_last_are_another_setting() -> None:
    one, five = setting(random_action_steps=1), setting(random_action_steps=5)
    assert one != five
    assert not one.differs_in_masks_alone(five)
    assert one.differs_in_masks_alone(setting(random_action_steps=1, cgm=False))
    assert not one.differs_in_masks_alone(one)
