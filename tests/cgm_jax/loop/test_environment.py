# pyright: reportAttributeAccessIssue=false
import functools
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from cgm_jax import envs
from cgm_jax.config.fields import SettingError
from cgm_jax.config.settings import Settings
from cgm_jax.loop.environment import calls_physics, make_environment, remarks_on
from cgm_jax.loop.judging import succeeds
from cgm_jax.loop.rollout import drawn_goals, reset, roll_out
from tests.cgm_jax import own_environments
from tests.cgm_jax.own_environments import Base

EXAMPLE = (Path(__file__).parents[2] / "examples" / "point_mass.py").read_text()
OWN = own_environments.__file__


def make(directory: Path, code: str, factory: str = "PointMass") -> object:
    path = directory / "envs.py"  # named like a package of ours, which it must not replace
    path.write_text(code)
    return make_environment(Settings(env=f"{path}:{factory}"))


def own(name: str) -> Any:
    return make_environment(Settings(env=f"{OWN}:{name}"))


def test_an_environment_comes_from_a_file_of_any_name(tmp_path: Path) -> None:
    env: Any = make(tmp_path, EXAMPLE)
    assert (env.action_size, env.episode_length, env.distance_threshold) == (2, 25, 0.1)
    assert envs.__file__ is not None
    assert Path(envs.__file__).parent.name == "envs"


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("import jax\n", "import nothing_of_that_name\n", "fails with ModuleNotFoundError"),
        ("class PointMass", "class Other", "has no function or class 'PointMass'"),
        ("    action_size: int = 2", "    action_size: int", "fails with TypeError"),
        ("    distance_threshold: float = 0.1\n", "", "lacks distance_threshold"),
        ('"desired_goal": goal', '"goal": goal', "is no dict with observation"),
        ('"achieved_goal": position', '"achieved_goal": velocity[:1]', "achieved_goal has shape"),
        (
            "0.7 * velocity",
            "jnp.zeros(3) * velocity",
            r"fails with TypeError.*envs.py, line 3",
        ),
    ],
)
def test_what_is_wrong_with_an_environment_is_said_in_one_line(
    tmp_path: Path, old: str, new: str, message: str
) -> None:
    assert old in EXAMPLE
    with pytest.raises(SettingError, match=message) as caught:
        make(tmp_path, EXAMPLE.replace(old, new))
    assert "\n" not in str(caught.value)


REFUSED = {
    "ScalarObservation": "reset of {}: observation has shape (), not [n]",
    "WholeObservation": "reset of {}: observation is int32, not float32",
    "ListObservation": "reset of {}: observation is list, not an array",
    "NoGoal": "reset of {}: observation has shape (0,), not [n]",
    "OtherObservationAfterStep": (
        "obs['observation'] of {} is float32[2] after reset and float32[3] after step"
    ),
    "OtherPhysicsAfterStep": (
        "pipeline_state['q'] of {} is float32[3] after reset and int32[3] after step"
    ),
    "OtherMemoryAfterStep": (
        "info['past'] of {} is float32[3] after reset and float32[4] after step"
    ),
    "SlowClock": "info['time'] of {} is int32[] after reset and float32[] after step",
    "Wrapping": "info['steps'] of {} is uint8[] after reset and int32[] after step",
    "MovingGoal": "step of {} changes desired_goal, which holds for an episode",
    "FarBeyondFloat32": "distance_threshold of {}, 0.1, is less than float32 can tell apart",
    "NoState": "reset of {} returns NoneType, not a brax State",
    "StepFails": "step of {} fails with TypeError: add got incompatible shapes",
    "BranchesOnValues": "step of {} fails with TracerBoolConversionError: Attempted boolean",
    "ResetExits": "reset of {} fails with SystemExit: enough",
    "PropertyFails": "{} fails with RuntimeError: not known",
    "Talkative": "{} fails with RuntimeError: what is restart?",
    "NoMapping": "jax.vmap over reset and step of {} fails with NotImplementedError",
    "NoSteps": "episode_length of {} is 0, not within [1, 1,000,000]",
    "BooleanSize": "action_size of {} is True, not a whole number",
    "FloatLength": "episode_length of {} is 25.0, not a whole number",
    "NaNLength": "episode_length of {} is nan, not a whole number",
    "HugeSize": "action_size of {} is 1000000000000000000000000000000, not within [1, 10,000]",
    "MethodLength": "episode_length of {} is <bound method",
    "NegativeThreshold": "distance_threshold of {} is -0.1, not within [1e-15, 1e+15]",
    "NaNThreshold": "distance_threshold of {} is nan, not within [1e-15, 1e+15]",
    "InfiniteThreshold": "distance_threshold of {} is inf, not within [1e-15, 1e+15]",
    "TextThreshold": "distance_threshold of {} is '0.1', not a number",
    "VectorThreshold": "distance_threshold of {} is array([0.1, 0.1]), not a number",
    "TooSmallThreshold": "distance_threshold of {} is 1e-30, not within [1e-15, 1e+15]",
    "nothing": "{} lacks reset, step, action_size, episode_length, distance_threshold",
}
WITH_A_LINE = (
    *("StepFails", "BranchesOnValues", "ResetExits", "PropertyFails", "NoMapping"),
    "Talkative",
)


@pytest.mark.parametrize("name", REFUSED)
def test_what_training_relies_on_is_checked_by_shapes_types_and_values(name: str) -> None:
    with pytest.raises(SettingError) as caught:
        own(name)
    assert str(caught.value).startswith(f"env: {REFUSED[name].format(f'{OWN}:{name}')}")
    assert "\n" not in str(caught.value)
    assert (f"({OWN}, line " in str(caught.value)) is (name in WITH_A_LINE)


@jax.jit
def towards_the_goal(observation: jax.Array, goal: jax.Array, noise: Any) -> jax.Array:
    del noise
    return jnp.clip(10.0 * (goal - observation), -1.0, 1.0)


def play(env: Any) -> Any:
    first = reset(env, jax.random.key(3), 8)
    return roll_out(env, towards_the_goal, first, drawn_goals(env, first))


@functools.cache
def play_healthy() -> Any:
    return play(Base())


@pytest.mark.parametrize("name", ["BooleanDone", "Careless", "PlainNumbers", "NoMetrics"])
def test_what_training_does_not_read_cannot_break_it(name: str) -> None:
    rollout, expected = play(own(name)), play_healthy()
    np.testing.assert_allclose(
        rollout.episodes.achieved_goal, expected.episodes.achieved_goal, atol=1e-6
    )
    assert rollout.outcomes.valid.all()
    assert rollout.outcomes.success.all()


def test_what_an_environment_keeps_for_itself_is_kept() -> None:
    env = own("Careless")
    first = state = env.reset(jax.random.key(0))
    for _ in range(4):
        state = env.step(state, jnp.zeros(2))
    assert state.state.info["steps"] == 4
    assert state.state.info["steps"].dtype == jnp.float32
    assert state.state.info["broken"] == 1
    assert state.state.info["broken"].dtype == jnp.int32  # as after reset
    assert state.state.info["rng"] != first.state.info["rng"]
    assert "extra" not in state.state.info
    (remark,) = remarks_on(env)
    assert remark == f"step of {OWN}:Careless adds info['extra'], which reset lacks: it is not kept"


def test_physics_warnings_of_any_type_are_noticed() -> None:
    assert not play(own("NaNWarning")).outcomes.valid.any()
    assert play(own("Careless")).outcomes.valid.all()


def test_numbers_of_numpy_and_jax_are_numbers() -> None:
    env = own("NumpyNumbers")
    assert (env.action_size, env.episode_length, env.distance_threshold) == (2, 25, 0.125)
    assert type(env.episode_length) is int


def test_values_that_are_not_finite_are_remarked_on() -> None:
    assert remarks_on(own("Base")) == []
    (remark,) = remarks_on(own("NeverValid"))
    assert remark.startswith("observation is not finite after reset of ")


@pytest.mark.parametrize("name", ["Drawn", "DrawnOnTheHost"])
def test_what_cannot_be_repeated_is_remarked_on(name: str) -> None:
    (remark,) = remarks_on(own(name))
    assert remark.startswith(f"reset and step of {OWN}:{name} give other values for the same key")


def test_settings_of_the_fetch_tasks_are_refused_for_other_environments(tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text(EXAMPLE)
    with pytest.raises(SettingError, match="are for the Fetch tasks"):
        make_environment(Settings(env=f"{tmp_path / 'mine.py'}:PointMass", engine="mjx"))


def test_a_fetch_environment_from_a_file_is_used_as_it_is(tmp_path: Path) -> None:
    code = "from cgm_jax import envs\ndef easy(): return envs.make('reach', 'native')\n"
    assert type(make(tmp_path, code, "easy")).__name__ == "FetchEnvironment"


RULED = """
import dataclasses
import jax.numpy as jnp
from cgm_jax import envs
from cgm_jax.envs.fetch import FetchEnvironment

class Ruled(FetchEnvironment):
    goal_tolerance = jnp.array([0.1, 0.1, SIZE])

def ruled():
    plain = envs.make("reach", "native")
    return Ruled(**{field.name: getattr(plain, field.name) for field in dataclasses.fields(plain)})
"""


def test_a_fetch_environment_with_own_rules_is_checked_and_compiled_as_one(tmp_path: Path) -> None:
    env: Any = make(tmp_path, RULED.replace("SIZE", "0.01"), "ruled")
    assert type(env).__name__ == "Ruled"
    assert calls_physics(env)
    off = jnp.array([0.07, 0.06, 0.0])  # 0.92 tolerances
    assert bool(succeeds(env, jnp.zeros(3), jnp.ones(3), off, jnp.asarray(0.05)))
    with pytest.raises(SettingError, match=r"goal_tolerance of .* is .*, not one number per"):
        make(tmp_path, RULED.replace("SIZE", "0.0"), "ruled")
