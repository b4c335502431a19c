"""Policies that do not go with their environment are refused before anything compiles."""

import re
from pathlib import Path

import numpy as np
import pytest

from cgm_jax.config.fields import SettingError
from cgm_jax.config.grid import build_groups
from cgm_jax.evaluate import main
from cgm_jax.storage.run_directory import RunDirectory
from tests.cgm_jax import own_environments

ENV = f"{own_environments.__file__}:Base"


def policy(observation: int = 2, goal: int = 2, action: int = 2, hidden: int = 4) -> dict:
    """One hidden layer; always the same action."""
    arrays = {
        "layer_0_kernel": np.zeros((observation + goal, hidden)),
        "layer_0_bias": np.zeros(hidden),
        "layer_1_kernel": np.zeros((hidden, action)),
        "layer_1_bias": np.zeros(action),
        "normalised_limit": np.array(5.0),
    }
    for kind, size in (("observation", observation), ("goal", goal)):
        arrays |= {f"{kind}_mean": np.zeros(size), f"{kind}_std": np.ones(size)}
    return arrays


BAD = {
    "made for observations of size 25, not 2": policy(observation=25),
    "made for goals of size 3, not 2": policy(goal=3),
    "made for actions of size 4, not 2": policy(action=4),
    "layer_1_bias holds numbers that are not finite": policy() | {"layer_1_bias": [np.nan, 0.0]},
    "its layers are others than those of": policy(hidden=5),
}


@pytest.mark.parametrize("complaint", BAD)
def test_a_policy_that_does_not_go_with_its_environment(complaint: str, tmp_path: Path) -> None:
    groups = build_groups("smoke", {"env": [ENV]})
    with RunDirectory.claimed(tmp_path, fresh=True) as directory:
        directory.config.write(groups, "smoke", "cpu")
    first, second = groups[0].runs
    directory.write_policy(first, policy())
    directory.write_policy(second, {k: np.asarray(v) for k, v in BAD[complaint].items()})
    line = f"{directory.policy_path(second)}: {complaint}"
    with pytest.raises(SettingError, match=f"^{re.escape(line)}[^\n]*$"):
        main([str(tmp_path), "--env", ENV, "--episodes", "4"])
