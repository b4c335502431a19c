"""Stable-Baselines3 takes the Gymnasium environments as they are: `make test-sb3`."""

import functools
from typing import Any

import gymnasium
import numpy as np
import pytest

import cgm_jax  # noqa: F401 -- registers the environments
from tests.envs.gymnasium.helpers import IDS, broken

# Large, and not among the requirements: tests/sb3-requirements.txt.
sb3 = pytest.importorskip("stable_baselines3")
env_checker, evaluation, monitor, vec_env = (
    pytest.importorskip(f"stable_baselines3.common.{name}")
    for name in ("env_checker", "evaluation", "monitor", "vec_env")
)

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


@pytest.mark.parametrize("env_id", IDS)
def test_its_own_checker_has_no_complaint(env_id: str) -> None:
    env_checker.check_env(gymnasium.make(env_id).unwrapped)  # warnings are errors here


def maker(**arguments: Any) -> Any:
    """For a process of its own, which finds the environments by the name of the package."""
    return functools.partial(gymnasium.make, "cgm_jax:cgm_jax/FetchPush-v0", **arguments)


@pytest.mark.slow
@pytest.mark.parametrize("start_method", [None, "spawn"])
def test_its_processes_run_the_same_episodes(start_method: str | None) -> None:
    makers = [maker(max_episode_steps=4)] * 2
    processes, here = (
        vec_env.SubprocVecEnv(makers, start_method=start_method),
        vec_env.DummyVecEnv(makers),
    )
    try:
        generator = np.random.default_rng(0)
        for env in (processes, here):
            env.seed(5)
        there, expected = processes.reset(), here.reset()
        goals = [expected["desired_goal"]]
        for step in range(6):  # past the end of an episode, which it resets in the same step
            for name, rows in expected.items():
                np.testing.assert_array_equal(there[name], rows)
            actions = generator.uniform(-1, 1, (2, 4)).astype(np.float32)
            there, *others = processes.step(actions)
            expected, *rest = here.step(actions)
            np.testing.assert_array_equal(others[:2], rest[:2])
            assert rest[1].tolist() == [step == 3] * 2
            goals.append(expected["desired_goal"])
            for one, other in zip(others[2], rest[2], strict=True):
                assert one["is_success"] == other["is_success"]
                assert one["TimeLimit.truncated"] is other["TimeLimit.truncated"] is (step == 3)
        assert np.abs(goals[5] - goals[0]).max() > 1e-3
        pair = [expected["achieved_goal"], expected["achieved_goal"]]
        rewards = processes.env_method("compute_reward", *pair, [{}, {}])
        np.testing.assert_array_equal(rewards, np.zeros((2, 2)))
    finally:
        processes.close()


@pytest.mark.slow
def test_hindsight_takes_several_processes() -> None:
    envs = vec_env.SubprocVecEnv([maker(max_episode_steps=10)] * 2, start_method="spawn")
    try:
        model = sb3.SAC(
            "MultiInputPolicy",
            envs,
            replay_buffer_class=sb3.HerReplayBuffer,
            replay_buffer_kwargs={"n_sampled_goal": LATER_GOALS},
            policy_kwargs={"net_arch": [16]},
            learning_starts=40,
            batch_size=32,
            seed=0,
        )
        model.learn(80)
        assert model.num_timesteps == 80
        assert all(np.isfinite(one.detach().numpy()).all() for one in model.actor.parameters())
    finally:
        envs.close()


def test_normalised_observations_and_evaluation() -> None:
    envs = vec_env.DummyVecEnv(
        [lambda: monitor.Monitor(gymnasium.make(IDS[0], max_episode_steps=5))] * 2
    )
    normalised = vec_env.VecNormalize(envs, norm_reward=False)
    model = sb3.SAC("MultiInputPolicy", normalised, policy_kwargs={"net_arch": [16]}, seed=0)
    returns, lengths = evaluation.evaluate_policy(model, normalised, 4, return_episode_rewards=True)
    assert lengths == [5] * 4
    assert all(one in range(-5, 1) for one in returns)


def test_broken_physics_ends_an_episode_there_too() -> None:
    envs = vec_env.DummyVecEnv([lambda: gymnasium.make(IDS[0])])
    envs.reset()
    inner = envs.envs[0].unwrapped
    inner.state = broken(inner.state)  # pyright: ignore[reportAttributeAccessIssue]
    _, _, dones, infos = envs.step(np.zeros((1, 4), np.float32))
    assert dones.tolist() == [True]
    assert infos[0]["TimeLimit.truncated"] is True
    assert infos[0]["physics_warnings"] > 0
