"""Adversarial actions on C MuJoCo; tests/envs/test_engines.py does the same on MJX."""

import numpy as np
import pytest

from cgm_jax import envs
from experiments.physics.scripted import Player
from tests.envs.adversary import ADVERSARIES, attack
from tests.envs.measures import finger_depth, object_speed, observations, warnings


@pytest.mark.parametrize("task", ["push", "pick_and_place"])
def test_adversarial_actions_break_nothing(task: str) -> None:
    player = Player(envs.make(task, engine="native"))
    states = player.play(attack, 200)
    observed = observations(states)
    assert np.isfinite(observed).all()
    assert warnings(states) == 0
    # A fall from the table ends at 2.8 m/s.
    assert object_speed(states).max() < 5.0

    by_adversary = {
        adversary.__name__: slice(i, None, len(ADVERSARIES))
        for i, adversary in enumerate(ADVERSARIES)
    }
    depth = finger_depth(player.env, states)
    for name in ("reverse", "press_into_table", "press_onto_object"):
        # The recorded reset pose of push has the fingers 5 mm in the table.
        assert depth[:, by_adversary[name]].max() < 0.008
    assert depth[:, by_adversary["press_into_table"]].max() > 0.0  # it was pressed
    assert depth.max() < 0.025  # into its edge, from the side

    moved = np.linalg.norm(observed[-1, :, 3:6] - observed[0, :, 3:6], axis=-1)
    fallen = observed[-1, :, 5] < 0.3
    assert (moved[by_adversary["reverse"]] > 0.01).mean() > 0.3
    assert (moved[by_adversary["squeeze_and_shake"]] > 0.01).mean() > 0.9
    assert fallen[by_adversary["shove_off_table"]].mean() > 0.9
