from pathlib import Path

import jax
import numpy as np
import pytest

from cgm_jax.config.fields import SettingError, stack
from cgm_jax.config.grid import build_groups
from cgm_jax.loop.environment import make_environment
from cgm_jax.loop.training import make_programs, make_trainer
from cgm_jax.storage.policies import policy_arrays

EXAMPLES = Path(__file__).parents[2] / "examples"
OPTIONS = {
    "env": [f"{EXAMPLES / 'point_mass.py'}:PointMass"],
    "agent": [f"{EXAMPLES / 'my_agent.py'}:MyAgent"],
    "curriculum": ["full"],
    "step_size": [0.0, 0.01],
    "width": [16],
}


def test_an_agent_of_the_users_own_trains_by_its_settings_and_exports_its_policy() -> None:
    (group,) = build_groups("smoke", OPTIONS)
    still, moving = group.runs
    assert (still.hyper.agent.width, moving.hyper.agent.step_size) == (16, 0.01)
    assert moving.name == "point_mass-PointMass_my_agent-MyAgent-her_full_stepsize0.01_seed0"
    programs = make_programs(make_trainer(make_environment(group.settings), group.settings))
    hyper = stack([still.hyper, moving.hyper])
    start = jax.tree.map(np.array, programs.start(hyper).agent)
    state, metrics = programs.evaluate(programs.train(programs.start(hyper), hyper, 2), hyper)
    same, changed = (
        [(x[i] == y[i]).all() for x, y in zip(*map(jax.tree.leaves, pair), strict=True)]
        for i, pair in enumerate([(start.actor, state.agent.actor)] * 2)
    )
    assert all(same)
    assert not any(changed)
    # Both saw the same transitions; only one learned from them.
    assert metrics["actor_loss"][1] < metrics["actor_loss"][0]
    assert "critic_loss" not in metrics
    assert metrics["failure"][:2].tolist() == [0, 0]  # rows left over follow
    own, normaliser = jax.tree.map(lambda leaf: leaf[1], (state.agent, state.normaliser))
    policy = policy_arrays(moving.hyper.agent.actor(own), normaliser)
    assert policy["layer_2_kernel"].shape == (16, 2)


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
