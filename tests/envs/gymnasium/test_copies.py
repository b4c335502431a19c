"""Environments are copied, pickled and made again from their specifications."""

# Gymnasium leaves its spaces and environments untyped.
# pyright: reportAttributeAccessIssue=false, reportOptionalMemberAccess=false

import copy
import json
import pickle
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec

from tests.envs.gymnasium.helpers import NAMES, assert_same_observations, make, make_vec
from tests.envs.surface import can_render

COPIES = {"deepcopy": copy.deepcopy, "pickle": lambda env: pickle.loads(pickle.dumps(env))}
copies = pytest.mark.parametrize("copied", COPIES.values(), ids=COPIES)


def continued(env: Any) -> list[Any]:
    """What follows from here, past the end of the episode: observations, rewards, ends."""
    results = []
    for _ in range(4):
        observation, reward, terminated, truncated, info = env.step(env.action_space.sample())
        results.append((observation, reward, terminated, truncated, info))
        if np.all(truncated) and not isinstance(env, gymnasium.vector.VectorEnv):
            results.append(env.reset())
    return results


def assert_same(one: Any, other: Any) -> None:
    assert type(one) is type(other)
    if isinstance(one, dict):
        assert list(one) == list(other)
        one, other = list(one.values()), list(other.values())
    if isinstance(one, list | tuple):
        for a, b in zip(one, other, strict=True):
            assert_same(a, b)
    else:
        np.testing.assert_array_equal(one, other)


@copies
@pytest.mark.parametrize("name", NAMES)
def test_a_copy_in_the_middle_of_an_episode_continues_alike(
    name: str, copied: Callable[[Any], Any]
) -> None:
    env = make(name, max_episode_steps=5)
    env.reset(seed=3)
    env.action_space.seed(3)
    for _ in range(3):
        env.step(env.action_space.sample())
    other = copied(env)
    original = continued(env)  # both of them, one after the other: neither moves the other
    assert_same(original, continued(other))
    assert env.np_random_seed == other.np_random_seed == 3
    assert_same(env.reset(), other.reset())
    with pytest.raises(AssertionError):  # the comparison does tell episodes apart
        assert_same(env.reset(), copied(env).reset(seed=9))


@copies
def test_a_copy_before_the_first_reset_is_an_environment_like_it(
    copied: Callable[[Any], Any],
) -> None:
    env = make("FetchPickAndPlace", air_probability=1.0, distance_threshold=0.2)
    other = copied(env)
    assert_same(env.reset(seed=1), other.reset(seed=1))
    assert other.unwrapped.fetch.distance_threshold == 0.2
    assert other.observation_space == env.observation_space


@copies
def test_a_batch_is_copied_with_its_episodes(copied: Callable[[Any], Any]) -> None:
    vector = make_vec("FetchPush", num_envs=3, max_episode_steps=5)
    unused = copied(vector)
    first = vector.reset(seed=3)
    assert_same(first, unused.reset(seed=3))
    vector.action_space.seed(3)
    for _ in range(3):
        vector.step(vector.action_space.sample())
    other = copied(vector)
    assert_same(continued(vector), continued(other))
    assert vector.np_random_seed == other.np_random_seed == (3, 4, 5)


@copies
@pytest.mark.skipif(not can_render(), reason="this machine has no off-screen rendering")
def test_a_copy_renders_on_a_surface_of_its_own(copied: Callable[[Any], Any]) -> None:
    env = make("FetchPush", render_mode="rgb_array", width=64, height=48)
    env.reset(seed=0)
    frame = env.render()
    other = copied(env)
    env.close()
    # Software rendering may shade a few pixels at edges otherwise on another surface.
    assert np.mean(other.render() != frame) < 0.002
    other.close()


def test_a_specification_makes_the_same_environment_again() -> None:
    env = make("FetchPickAndPlace", air_probability=1.0, max_episode_steps=7, width=320)
    for again in (
        gymnasium.make(env.spec),
        gymnasium.make(EnvSpec.from_json(env.spec.to_json())),
    ):
        assert_same(env.reset(seed=2), again.reset(seed=2))
        assert again.spec == env.spec
        assert again.spec.max_episode_steps == 7
    bare = gymnasium.make(env.unwrapped.spec)  # without wrappers, as Gymnasium has it
    assert_same(env.reset(seed=2), bare.reset(seed=2))
    assert json.loads(env.unwrapped.spec.to_json())["kwargs"] == {
        "task": "pick_and_place",
        "air_probability": 1.0,
        "width": 320,
    }


def test_a_batchs_specification_makes_the_same_batch_again() -> None:
    vector = make_vec("FetchPush", num_envs=3, max_episode_steps=2)
    again = gymnasium.make_vec(vector.spec)
    assert type(again) is type(vector)
    assert_same(vector.reset(seed=2), again.reset(seed=2))
    action = np.zeros((3, 4), np.float32)
    assert_same([vector.step(action) for _ in range(3)], [again.step(action) for _ in range(3)])


@pytest.mark.slow
def test_a_pickled_environment_continues_in_another_process(tmp_path: Path) -> None:
    env = make("FetchPush")
    env.reset(seed=3)
    env.step(np.ones(4, np.float32))
    (tmp_path / "env").write_bytes(pickle.dumps(env))
    program = (
        "import pickle, sys, numpy as np\n"
        "env = pickle.load(open(sys.argv[1] + '/env', 'rb'))\n"
        "steps = [env.step(np.ones(4, np.float32))[0] for _ in range(5)] + [env.reset()[0]]\n"
        "pickle.dump(steps, open(sys.argv[1] + '/steps', 'wb'))\n"
    )
    subprocess.run([sys.executable, "-c", program, str(tmp_path)], check=True)
    there = pickle.loads((tmp_path / "steps").read_bytes())
    here = [env.step(np.ones(4, np.float32))[0] for _ in range(5)] + [env.reset()[0]]
    assert_same_observations(here, there)
