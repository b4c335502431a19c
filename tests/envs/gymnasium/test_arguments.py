"""What has no effect, or is of another shape or type, is refused before anything changes."""

# Gymnasium leaves its spaces and environments untyped.
# pyright: reportAttributeAccessIssue=false, reportOptionalMemberAccess=false

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from gymnasium.error import Error

from cgm_jax.envs.gymnasium.fetch import FetchGymnasium
from cgm_jax.envs.gymnasium.vector import FetchVector
from tests.envs.gymnasium.helpers import assert_same_observations, make, make_vec

NAN, INF = float("nan"), float("inf")


@pytest.fixture(scope="module")
def single() -> Any:
    env = make("FetchReach")
    env.reset(seed=0)
    return env


@pytest.fixture(scope="module")
def vector() -> Any:
    env = make_vec("FetchReach", num_envs=2)
    env.reset(seed=0)
    return env


BAD_ACTIONS = [
    ([0, 0, 1], r"shape \(3,\) is not \(4,\)"),
    ([0, 0, 0, 0, 0], r"shape \(5,\) is not \(4,\)"),
    ([[0, 0, 0, 0]], r"shape \(1, 4\) is not \(4,\)"),
    ([[0], [0], [0], [0]], r"shape \(4, 1\) is not \(4,\)"),
    (0.5, r"shape \(\) is not \(4,\)"),
    ([], r"shape \(0,\) is not \(4,\)"),
    ({"action": [0, 0, 0, 0]}, r"shape \(\) is not \(4,\)"),
    ([0, 0, [0, 1], 0], r"no array of shape \(4,\)"),
    (["0", "0", "0", "0"], "no real numbers"),
    ([None, None, None, None], "no real numbers"),
    (np.zeros(4, complex), "no real numbers"),
    (np.zeros(4, bool), "no real numbers"),
    ([0, NAN, 0, 0], r"nan at \[1\] is not finite"),
    ([0, 0, 0, -INF], "not finite"),
]


@pytest.mark.parametrize(("action", "message"), BAD_ACTIONS)
def test_a_wrong_action_is_refused_and_nothing_has_moved(
    single: Any, action: Any, message: str
) -> None:
    before = single.unwrapped.state
    with pytest.raises(ValueError, match=f"action: .*{message}"):
        single.unwrapped.step(action)
    assert single.unwrapped.state is before


@pytest.mark.parametrize(("action", "message"), BAD_ACTIONS)
def test_gymnasium_make_refuses_them_too(action: Any, message: str) -> None:
    env = make("FetchReach", disable_env_checker=True)  # whose remarks come on top
    env.reset(seed=0)
    with pytest.raises(ValueError, match=f"action: .*{message}"):
        env.step(action)


@pytest.mark.parametrize(
    "action",
    [
        [0, 0, 1, 0],
        (0.0, 0.0, 1.0, 0.0),
        np.array([0, 0, 1, 0], np.float64),
        np.array([0, 0, 1, 0], np.int8),
        np.array([0, 0, 7, 0], np.float32),
        np.array([0, 0, 1e300, 0]),
    ],
)
def test_an_action_is_any_four_numbers_and_is_clipped(action: Any) -> None:
    results = []
    for given in (np.array([0, 0, 1, 0], np.float32), action):
        env = make("FetchReach", disable_env_checker=True)
        env.reset(seed=0)
        results.append([env.step(given)[0]])
    assert_same_observations(*results)


@pytest.mark.parametrize(
    ("actions", "message"),
    [
        (np.zeros((2, 3)), r"shape \(2, 3\) is not \(2, 4\)"),
        (np.zeros((2, 5)), r"shape \(2, 5\) is not \(2, 4\)"),
        (np.zeros((3, 4)), r"shape \(3, 4\) is not \(2, 4\)"),
        (np.zeros(4), r"shape \(4,\) is not \(2, 4\)"),
        (np.zeros((2, 4, 1)), r"shape \(2, 4, 1\) is not \(2, 4\)"),
        ([[0, 0, 0, 0], [0, 0, 0]], r"no array of shape \(2, 4\)"),
        ([[0, 0, 0, 0], [0, NAN, 0, 0]], r"nan at \[1, 1\] is not finite"),
        (np.zeros((2, 4), object), "no real numbers"),
    ],
)
def test_wrong_actions_of_a_batch_are_refused_and_nothing_has_moved(
    vector: Any, actions: Any, message: str
) -> None:
    before = vector.state
    with pytest.raises(ValueError, match=f"action: .*{message}"):
        vector.step(actions)
    assert vector.state is before


def test_a_batch_takes_lists_and_whole_numbers() -> None:
    results = []
    for actions in (
        np.array([[1, 0, 0, 0], [0, 1, 0, 0]], np.float32),
        [[1, 0, 0, 0], [0, 1, 0, 0]],
        (np.array([1.0, 0, 0, 0]), np.array([0, 1.0, 0, 0])),
    ):
        env = make_vec("FetchReach", num_envs=2)
        env.reset(seed=0)
        results.append([env.step(actions)[0]])
    assert_same_observations(results[0], results[1])
    assert_same_observations(results[0], results[2])


def test_the_action_of_a_row_that_is_reset_has_no_part_in_it() -> None:
    env = make_vec("FetchReach", num_envs=2, max_episode_steps=1)
    env.reset(seed=0)
    assert env.step(np.zeros((2, 4)))[3].all()
    observation, *_ = env.step(np.full((2, 4), NAN))
    assert np.isfinite(observation["observation"]).all()
    with pytest.raises(ValueError, match="not finite"):
        env.step(np.full((2, 4), NAN))


WRONG_ARGUMENTS: list[tuple[dict[str, Any], type[Exception], str]] = [
    ({"render_mode": "ansi"}, ValueError, "render_mode: 'ansi'"),
    ({"air_probability": 0.5}, ValueError, "air_probability: the object of push"),
    ({"colour": 1.0}, ValueError, "colour: no such field; choose from air_prob"),
    ({"episode_length": 10}, ValueError, "episode_length: .*max_episode_steps"),
    ({"reward_type": "dense"}, ValueError, "reward_type: no such field"),
    ({"distance_threshold": 0.0}, ValueError, "distance_threshold: 0.0 is not above 0"),
    ({"distance_threshold": NAN}, ValueError, "distance_threshold: nan is not finite"),
    ({"distance_threshold": INF}, ValueError, "distance_threshold: inf is not finite"),
    ({"distance_threshold": "5 cm"}, TypeError, "distance_threshold: '5 cm' is no number"),
    ({"distance_threshold": True}, TypeError, "distance_threshold: True is no number"),
    ({"distance_threshold": [0.05]}, TypeError, "distance_threshold: .* is no number"),
    ({"air_probability": -0.1}, ValueError, "air_probability: -0.1 is not within"),
    ({"engine": "bullet"}, ValueError, "engine: unknown engine 'bullet'"),
    ({"engine": ["native"]}, ValueError, "engine: unknown engine"),
    ({"task": "slide"}, ValueError, "env: unknown environment 'slide'"),
    ({"width": 0}, ValueError, r"width: 0 is not within \[1, 1280\]"),
    ({"height": 5000}, ValueError, r"height: 5000 is not within \[1, 960\]"),
    ({"width": 64.0}, TypeError, "width: 64.0 is no integer"),
    ({"width": True}, TypeError, "width: True is no integer"),
]


@pytest.mark.filterwarnings("ignore:.*render_mode='ansi':UserWarning")
@pytest.mark.parametrize(("arguments", "kind", "message"), WRONG_ARGUMENTS)
@pytest.mark.parametrize("maker", [make, lambda name, **given: make_vec(name, 1, **given)])
def test_wrong_arguments_are_refused_by_name(
    maker: Callable[..., Any], arguments: dict[str, Any], kind: type[Exception], message: str
) -> None:
    with pytest.raises(kind, match=message):
        maker("FetchPush", **arguments)


@pytest.mark.parametrize("environment", [FetchGymnasium, FetchVector])
def test_the_classes_themselves_refuse_as_well(environment: Any) -> None:
    with pytest.raises(ValueError, match=r"episode_length: .*max_episode_steps"):
        environment("reach", episode_length=10)
    if environment is FetchGymnasium:
        with pytest.raises(ValueError, match=r"max_episode_steps: .*gymnasium\.make"):
            environment("reach", max_episode_steps=10)


def test_true_is_no_number_of_steps() -> None:
    with pytest.raises(TypeError, match="max_episode_steps: True is no integer"):
        FetchVector("reach", 2, max_episode_steps=True)


def test_other_ways_to_autoreset_are_refused_with_what_to_write() -> None:
    with pytest.raises(ValueError, match=r"autoreset_mode: .*vectorization_mode=.sync"):
        make_vec("FetchReach", 2, autoreset_mode="SameStep")


@pytest.mark.parametrize("mode", ["SameStep", "Disabled"])
def test_what_to_write_works(mode: str) -> None:
    vector = make_vec(
        "FetchReach",
        2,
        vectorization_mode="sync",
        vector_kwargs={"autoreset_mode": mode},
        max_episode_steps=2,
    )
    first, _ = vector.reset(seed=0)
    vector.step(np.zeros((2, 4), np.float32))
    last, _, _, truncated, infos = vector.step(np.zeros((2, 4), np.float32))
    assert truncated.all()
    moved = np.abs(last["desired_goal"] - first["desired_goal"]).max(axis=1) > 1e-3
    assert moved.tolist() == [mode == "SameStep"] * 2
    assert ("final_obs" in infos) is (mode == "SameStep")


@pytest.mark.parametrize(
    ("num_envs", "kind"),
    [(0, ValueError), (-3, ValueError), (2.0, TypeError), ("2", TypeError), (True, TypeError)],
)
def test_a_batch_has_at_least_one_row(num_envs: Any, kind: type[Exception]) -> None:
    with pytest.raises(kind, match="num_envs: "):
        make_vec("FetchReach", num_envs)


@pytest.mark.parametrize(
    ("steps", "kind"),
    [(0, ValueError), (-2, ValueError), (2.5, TypeError), ("9", TypeError), (INF, TypeError)],
)
@pytest.mark.parametrize("maker", [make, lambda name, **given: make_vec(name, 1, **given)])
def test_wrong_episode_lengths_are_refused_as_gymnasium_does(
    maker: Callable[..., Any], steps: Any, kind: type[Exception]
) -> None:
    with pytest.raises(kind, match="max_episode_steps"):
        maker("FetchReach", max_episode_steps=steps)


@pytest.mark.parametrize(("steps", "length"), [(None, 50), (-1, math.inf), (10, 10), (1, 1)])
def test_episode_lengths_are_those_of_gymnasium_make(steps: int | None, length: float) -> None:
    env = make("FetchReach", max_episode_steps=steps)
    vector = make_vec("FetchReach", 2, max_episode_steps=steps)
    env.reset(seed=0)
    vector.reset(seed=0)
    expected = [step >= length for step in range(1, 61)][: int(min(length, 60))]
    action = np.zeros((2, 4), np.float32)
    assert [env.step(action[0])[3] for _ in expected] == expected
    assert [vector.step(action)[3].tolist() for _ in expected] == [[end] * 2 for end in expected]


@pytest.mark.parametrize(
    ("options", "kind", "message"),
    [
        ({"goal": [1, 2, 3]}, ValueError, "'goal' has no effect"),
        ({"low": -0.1}, ValueError, "'low' has no effect"),
        ({"reset_mask": np.ones(1, bool)}, ValueError, "'reset_mask' has no effect"),
        (["goal"], TypeError, "neither a dict nor None"),
        ("goal", TypeError, "neither a dict nor None"),
        (1, TypeError, "neither a dict nor None"),
    ],
)
def test_options_without_effect_are_refused_and_nothing_has_moved(
    single: Any, options: Any, kind: type[Exception], message: str
) -> None:
    inner = single.unwrapped
    before, randomness = inner.state, inner.np_random.bit_generator.state
    with pytest.raises(kind, match=f"options: .*{message}"):
        inner.reset(seed=5, options=options)
    assert inner.state is before
    assert inner.np_random.bit_generator.state == randomness


def test_no_options_are_an_empty_dict() -> None:
    env = make("FetchReach")
    with_none, _ = env.reset(seed=3)
    with_empty, _ = env.reset(seed=3, options={})
    assert_same_observations([with_none], [with_empty])


@pytest.mark.parametrize("seed", [-1, 1.5, "7", np.int64(3), [1]])
def test_seeds_are_whole_numbers_from_zero(single: Any, seed: Any) -> None:
    before = single.unwrapped.state
    with pytest.raises(Error, match=r"Seed must be|seed: "):
        single.unwrapped.reset(seed=seed)
    assert single.unwrapped.state is before


@pytest.mark.parametrize(
    ("seed", "kind"),
    [
        (-1, Error),
        (1.5, Error),
        ("ab", Error),
        (np.int64(3), Error),
        ([1, -1], Error),
        ([1, 1.5], Error),
        ({1: 2, 3: 4}, Error),
        ([1], ValueError),
        ([1, 2, 3], ValueError),
        ([], ValueError),
    ],
)
def test_a_batch_takes_one_seed_or_one_for_each_row(
    vector: Any, seed: Any, kind: type[Exception]
) -> None:
    before, seeds = vector.state, vector.np_random_seed
    with pytest.raises(kind, match=r"Seed must be|seed: "):
        vector.reset(seed=seed)
    assert vector.state is before
    assert vector.np_random_seed == seeds


@pytest.mark.parametrize(
    ("shape", "other"), [((3,), (2,)), ((4, 3), (4, 1)), ((4, 3), (5, 3)), ((), ()), ((2,), (2,))]
)
def test_goals_of_other_shapes_have_no_reward(
    single: Any, shape: tuple[int, ...], other: tuple[int, ...]
) -> None:
    with pytest.raises(ValueError, match=r"_goal: shape|broadcast"):
        single.unwrapped.compute_reward(np.zeros(shape), np.zeros(other), None)
