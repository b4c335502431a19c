"""Stable-Baselines3's HER trains on the Gymnasium environments as they are: `make test-sb3`."""

from typing import Any

import gymnasium
import numpy as np
import pytest

import cgm_jax  # noqa: F401 -- registers the environments

# Large, and not among the requirements: tests/sb3-requirements.txt.
sb3 = pytest.importorskip("stable_baselines3")

LATER_GOALS = 4


@pytest.mark.slow
@pytest.mark.parametrize("name", ["FetchReach", "FetchPush", "FetchPickAndPlace"])
def test_hindsight_experience_replay_trains_unchanged(name: str) -> None:
    env = gymnasium.make(f"cgm_jax/{name}-v0")
    model = sb3.DDPG(
        "MultiInputPolicy",
        env,
        replay_buffer_class=sb3.HerReplayBuffer,
        replay_buffer_kwargs={"n_sampled_goal": LATER_GOALS, "goal_selection_strategy": "future"},
        policy_kwargs={"net_arch": [32, 32]},
        learning_starts=100,
        batch_size=64,
        train_freq=20,
        seed=0,
    )
    before = [weights.detach().numpy().copy() for weights in model.actor.parameters()]
    model.learn(300)
    after = [weights.detach().numpy() for weights in model.actor.parameters()]
    assert all(np.isfinite(weights).all() for weights in after)
    assert any((a != b).any() for a, b in zip(after, before, strict=True))

    sample: Any = model.replay_buffer.sample(2000)
    reached = sample.next_observations["achieved_goal"].numpy()
    goals = sample.observations["desired_goal"].numpy()
    achieved = ((reached - goals) ** 2).sum(axis=1) ** 0.5 < 0.05
    np.testing.assert_array_equal(sample.rewards.numpy().ravel(), np.where(achieved, 0.0, -1.0))
    # Six episodes have six goals of their own; the others were reached later.
    own = {tuple(goal.astype(np.float32)) for goal in own_goals(env, episodes=6)}
    relabelled = np.mean([tuple(goal) not in own for goal in goals])
    assert relabelled == pytest.approx(LATER_GOALS / (LATER_GOALS + 1), abs=0.05)
    assert sample.dones.sum() == 0  # a time limit is no end of the task
    env.close()


def own_goals(env: gymnasium.Env[Any, Any], episodes: int) -> list[np.ndarray]:
    """Goals of the first episodes after seeding with 0, as the training saw them."""
    goals = [env.reset(seed=0)[0]["desired_goal"]]
    goals += [env.reset()[0]["desired_goal"] for _ in range(episodes - 1)]
    return goals
