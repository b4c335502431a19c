"""Training with stages on the way to the goal, on a crane that has two."""

import dataclasses
import re
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from cgm_jax.config.fields import SettingError
from cgm_jax.curricula.protocol import Goals
from cgm_jax.envs import Stage, make
from cgm_jax.loop.cycle import training_policy
from cgm_jax.loop.evaluation import final_policy
from cgm_jax.loop.exploration import Exploration
from cgm_jax.loop.judging import rewards
from cgm_jax.loop.own_checks import PROTOCOL, checked
from cgm_jax.loop.own_environment import OwnEnvironment
from cgm_jax.loop.training import make_trainer
from cgm_jax.replay.protocol import Transitions
from cgm_jax.storage.policies import act, policy_arrays
from tests.cgm_jax.probe import TINY, tiny
from tests.cgm_jax.storage.test_policies import readme_policy
from tests.examples.crane import Crane
from tests.examples.point_mass import PointMass

CRANE = Crane()
TRAINER = make_trainer(CRANE, TINY)


def played(weight: float) -> dict[str, np.ndarray]:
    """Actions of fresh networks, whose weights on the stages are multiplied."""
    hyper = tiny(relabelling="relay", evaluate_target=False)
    state = TRAINER.init(hyper)
    actor = jax.tree.map(lambda leaf: leaf, state.agent.actor)
    kernel = actor["params"]["layer_0"]["kernel"]
    assert kernel.shape[0] == 5 + 2 + 2 + 3  # observation, goal, flags, what remains
    actor["params"]["layer_0"]["kernel"] = kernel.at[7:].multiply(weight)
    state = state.replace(agent=state.agent.replace(actor=actor))
    # Stage 1 is pursued, stage 2, and the goal.
    observation = jnp.array([[0.5, 0, 0, 0, 0], [0.05, 0, 0, 0, 0], [0.05, 0, 0, 0, 1.0]])
    goal = jnp.array([[0.3, -0.4]] * 3)
    goals = Goals(goal, jnp.ones((3, 2)), jnp.full(3, 0.1))
    zeros = jnp.zeros((3, 3))
    noise = Exploration(zeros, zeros, jnp.zeros((3, 1), bool), uniform=jnp.zeros(3))
    exploring = training_policy(TRAINER.setup, state, hyper, goals)
    evaluated = final_policy(TRAINER.setup, state, hyper, goals)
    policy = policy_arrays(hyper.agent.actor(state.agent), state.normaliser)
    return {
        "exploring": np.asarray(exploring(observation, goal, noise)),
        "other_goal": np.asarray(exploring(observation, -goal, noise)),
        "evaluated": np.asarray(evaluated(observation, goal, None)),
        "exported": np.asarray(act(policy, observation, goal)),
        "policy": policy,  # pyright: ignore[reportReturnType]
        "observation": np.asarray(observation),
        "goal": np.asarray(goal),
    }


def test_exploration_sees_the_stage_or_the_goal_and_evaluation_the_goal_alone(
    tmp_path: Path,
) -> None:
    plain, heavy = played(1.0), played(3.0)
    for name in ("evaluated", "exported"):
        np.testing.assert_array_equal(plain[name], heavy[name])
        np.testing.assert_allclose(plain[name], plain["evaluated"], atol=1e-6)
    changed = (plain["exploring"] != heavy["exploring"]).any(axis=1)
    np.testing.assert_array_equal(changed, [True, True, False])
    np.testing.assert_array_equal(plain["exploring"][2], plain["evaluated"][2])
    # These stages do not depend on the goal, which is hidden while one is pursued.
    by_goal = (plain["exploring"] != plain["other_goal"]).any(axis=1)
    np.testing.assert_array_equal(by_goal, [False, False, True])
    path = tmp_path / "policy.npz"
    np.savez(path, **plain["policy"])  # pyright: ignore[reportCallIssue]
    for i in range(3):
        action = readme_policy(path, plain["observation"][i], plain["goal"][i])
        np.testing.assert_allclose(action, plain["evaluated"][i], atol=1e-6)


@dataclasses.dataclass(frozen=True)
class Unstaged(Crane):
    stages = ()  # pyright: ignore[reportAssignmentType, reportIncompatibleMethodOverride]


def test_stages_change_no_instruction_of_training_unless_they_are_asked_for() -> None:
    programs = []
    for env in (CRANE, Unstaged()):
        trainer, hyper = make_trainer(env, TINY), tiny()
        state = jax.eval_shape(trainer.init, hyper)
        programs.append(str(jax.make_jaxpr(trainer.epoch)(state, hyper)))
    addresses = re.compile(" at 0x[0-9a-f]+")
    with_stages, without = (addresses.sub("", program) for program in programs)
    assert with_stages == without


def test_an_environment_without_stages_is_refused() -> None:
    complaint = "^relabelling: relay needs stages, and probe declares none"
    with pytest.raises(SettingError, match=complaint):
        make_trainer(PointMass(), TINY).init(tiny(relabelling="relay"))


@dataclasses.dataclass(frozen=True)
class Rewarding(Crane):
    reward_range = (0.0, 1.0)

    def goal_success(self, achieved_goal: jax.Array, desired_goal: jax.Array) -> jax.Array:
        return jnp.asarray(False)

    def goal_reward(self, achieved_goal: jax.Array, desired_goal: jax.Array) -> jax.Array:
        return jnp.zeros(())


def test_an_environment_with_rewards_of_its_own_is_refused() -> None:
    with pytest.raises(SettingError, match=r"^relabelling: stages have rewards of"):
        make_trainer(Rewarding(), TINY).init(tiny(relabelling="relay"))


@dataclasses.dataclass(frozen=True)
class Unsuccessful(Crane):
    def goal_success(self, achieved_goal: jax.Array, desired_goal: jax.Array) -> jax.Array:
        return jnp.asarray(False)


def test_a_rule_of_success_is_for_the_goal_and_not_for_stages() -> None:
    subgoal = jnp.array([[1.0, 0, 0.5, 0, 0], [0.0, 1, 0, 0, 0.5], [0.0, 0, 0, 0, 0]])
    three = jnp.zeros((3, 2))
    drawn = Transitions(
        observation=jnp.zeros((3, 5)),
        goal=three,
        mask=jnp.ones((3, 2)),
        threshold=jnp.full(3, 0.1),
        action=jnp.zeros((3, 3)),
        reward=jnp.zeros(3),
        next_observation=jnp.zeros((3, 5)),
        next_goal=three,
        next_achieved=three,
        subgoal=subgoal,
    )
    np.testing.assert_array_equal(rewards(Unsuccessful(), drawn), [0.0, 0.0, -1.0])


@pytest.mark.parametrize(
    ("stage", "complaint"),
    [
        (None, "hold NoneType, not an envs.Stage"),
        (Stage(lambda o: o[:2], lambda o, g: g[:1], 2, 0.1), r"desired .* float32\[1\], not"),
        (Stage(lambda o: jnp.sum(o), lambda o, g: g, 2, 0.1), r"achieved .* not float32\[2\]"),
        (Stage(lambda o: o[:2], lambda o, g: g, 2, -0.1), "distance_threshold .* -0.1, not within"),
        (Stage(lambda o: o[:2], lambda o, g: g, 2.5, 0.1), "size .* 2.5, not a whole"),  # pyright: ignore
        (Stage(lambda o: o[:2] @ o, lambda o, g: g, 2, 0.1), "stage 1 of .* fails with TypeError"),
    ],
)
def test_what_is_wrong_with_a_stage_is_said_in_one_line(stage: Any, complaint: str) -> None:
    @dataclasses.dataclass(frozen=True)
    class Wrong(Crane):
        stages = (stage,)  # pyright: ignore[reportAssignmentType, reportIncompatibleMethodOverride]

    with pytest.raises(SettingError, match=complaint):
        checked(Wrong(), "crane.py:Wrong")


def test_stages_of_an_environment_of_ones_own_are_its_own() -> None:
    stages = CRANE.stages
    env = SimpleNamespace(**{name: getattr(CRANE, name) for name in PROTOCOL}, stages=stages)
    assert OwnEnvironment(env, "crane").stages == stages
    del env.stages
    assert OwnEnvironment(env, "crane").stages == ()


def approach(name: str, grip: list[float], goal: list[float]) -> np.ndarray:
    """Where the grip is to be, with the object at (1.3, 0.7, 0.4)."""
    (stage,) = make(name).stages
    observation = jnp.array([*grip, 1.3, 0.7, 0.4, *np.zeros(19)])
    np.testing.assert_allclose(stage.achieved(observation), grip)
    return np.asarray(stage.desired(observation, jnp.array(goal)))


@pytest.mark.parametrize(
    ("name", "grip", "goal", "expected"),
    [
        # 6 cm behind the object on the way (3, 4) / 5 to the goal; 10 cm higher while far away.
        ("push", [1.264, 0.652, 0.7], [1.6, 1.1, 0.4], [1.264, 0.652, 0.4]),
        ("push", [1.264, 0.632, 0.7], [1.6, 1.1, 0.4], [1.264, 0.652, 0.4]),
        ("push", [1.264, 0.622, 0.7], [1.6, 1.1, 0.4], [1.264, 0.652, 0.42]),
        ("push", [1.464, 0.652, 0.4], [1.6, 1.1, 0.4], [1.264, 0.652, 0.5]),
        # Less far behind within 5 cm of the goal.
        ("push", [1.27, 0.7, 0.4], [1.325, 0.7, 0.4], [1.27, 0.7, 0.4]),
        ("pick_and_place", [1.3, 0.7, 0.6], [1.6, 1.1, 0.8], [1.3, 0.7, 0.4]),
        ("pick_and_place", [1.3, 0.73, 0.6], [1.6, 1.1, 0.8], [1.3, 0.7, 0.41]),
    ],
)
def test_fetch_tasks_first_bring_the_grip_where_it_can_move_the_object(
    name: str, grip: list[float], goal: list[float], expected: list[float]
) -> None:
    np.testing.assert_allclose(approach(name, grip, goal), expected, atol=1e-6)


def test_reach_has_no_stages() -> None:
    assert make("reach").stages == ()


@pytest.mark.slow
@pytest.mark.parametrize("name", ["push", "pick_and_place"])
def test_a_grip_that_goes_where_the_stage_says_gets_there_and_spares_the_object(name: str) -> None:
    env = make(name)
    (stage,) = env.stages

    @jax.jit
    def follow(key: jax.Array) -> tuple[jax.Array, jax.Array]:
        def step(state: Any, _: None) -> tuple[Any, Any]:
            seen, goal = state.obs["observation"], state.obs["desired_goal"]
            remaining = stage.desired(seen, goal) - stage.achieved(seen)
            reached = jnp.linalg.norm(remaining) < stage.distance_threshold
            action = jnp.append(jnp.clip(10.0 * remaining, -1.0, 1.0), 1.0)
            return env.step(state, action), (reached, state.obs["achieved_goal"])

        _, (reached, place) = jax.lax.scan(step, env.reset(key), None, length=30)
        return reached.any(), jnp.linalg.norm(place[jnp.argmax(reached)] - place[0])

    reached, moved = jax.vmap(follow)(jax.random.split(jax.random.key(0), 16))
    assert reached.all()
    assert (moved < 0.02).mean() >= 0.8


@pytest.mark.slow
def test_stages_pursued_first_move_the_load_far_sooner() -> None:
    settings = dataclasses.replace(
        TINY, environments=16, updates_per_cycle=40, batch_size=128, replay_transitions=100_000
    )
    moved = {}
    for relabelling in ("future", "relay"):
        hyper = tiny(
            relabelling=relabelling,
            curriculum="full",
            her_filter=True,
            hidden_layers=(64, 64),
            target_rate=0.005,
        )
        trainer = make_trainer(CRANE, settings)
        train, evaluate = jax.jit(trainer.train), jax.jit(trainer.evaluate)
        state, _ = evaluate(train(trainer.init(hyper), hyper, 60), hyper)
        _, metrics = evaluate(train(state, hyper, 20), hyper)
        moved[relabelling] = float(metrics["moved_share"])
    assert moved["relay"] > 2 * moved["future"]
    assert moved["relay"] > 0.3
