"""Refusals of an agent of the user's own; test_my_curriculum.py of the examples trains one."""

from pathlib import Path

import pytest

from cgm_jax.config.fields import SettingError
from cgm_jax.config.grid import build_groups

EXAMPLES = Path(__file__).parents[2] / "examples"
OPTIONS = {
    "env": [f"{EXAMPLES / 'point_mass.py'}:PointMass"],
    "agent": [f"{EXAMPLES / 'my_agent.py'}:MyAgent"],
    "curriculum": ["full"],
    "step_size": [0.0, 0.01],
    "width": [16],
}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"step_size": [-1.0]}, "^step_size: -1.0 is not at least 0$"),
        ({"width": [2.5]}, "^width: 2.5 is not of type int$"),
        ({"discount": [0.9]}, "^discount: is no setting of"),
        ({"agent": [f"{EXAMPLES / 'my_agent.py'}:MyState"]}, "is not derived from Agent$"),
        ({"agent": [f"{EXAMPLES / 'my_agent.py'}:descend"]}, "is not a class made by @settings$"),
        (
            {"agent": ["nobody"]},
            "^agent: unknown agent 'nobody'; choose from ddpg, sac, td3, or FILE.py:NAME",
        ),
    ],
)
def test_what_is_wrong_with_it_is_told_in_one_line(change: dict[str, list], message: str) -> None:
    with pytest.raises(SettingError, match=message):
        build_groups("smoke", {**OPTIONS, **change})
