import jax
import jax.numpy as jnp
import numpy as np
import pytest

from cgm_jax.config.fields import SettingError
from cgm_jax.config.grid import build_groups, hyperparameters
from cgm_jax.curricula.vds import VDS, log_weights
from cgm_jax.loop.inputs import network_inputs
from cgm_jax.loop.training import make_trainer
from tests.cgm_jax.curricula.line import SIZES, Line, drawn_goals, outcomes, view, walk
from tests.cgm_jax.probe import TINY, tiny
from tests.examples.point_mass import PointMass


@pytest.mark.parametrize("power", [0.0, 1.0, 2.0])
def test_goals_count_by_the_deviation_of_critics(power: float) -> None:
    spread = np.random.default_rng(0).uniform(0.1, 2.0, size=(3, 8)).astype(np.float32)
    probabilities = jax.nn.softmax(log_weights(jnp.asarray(spread), power), axis=1)
    expected = spread**power / (spread**power).sum(axis=1, keepdims=True)
    np.testing.assert_allclose(probabilities, expected, rtol=1e-5)


def test_where_critics_agree_on_all_goals_they_are_uniform_and_else_never_drawn() -> None:
    spread = jnp.array([[0.0, 0.0, 0.0], [0.0, 1.0, 3.0]])
    probabilities = jax.nn.softmax(log_weights(spread, 1.0), axis=1)
    np.testing.assert_allclose(probabilities, [[1 / 3] * 3, [0, 0.25, 0.75]], rtol=1e-6)


def test_episodes_get_goals_by_what_critics_say_of_their_own_start() -> None:
    """Critics say 0, x and 2 x, for x of the start where the goal is 1; so its deviation."""
    observation = np.repeat([[0.0, 0.0], [3.0, 0.0]], 2000, axis=0)

    def value(observation: jax.Array, goal: jax.Array) -> jax.Array:
        told = observation[..., 0] * goal[..., 0] + (1.0 - goal[..., 0])
        return jnp.stack([0.0 * told, told, 2.0 * told])

    curriculum = VDS(candidates=2)
    goals = curriculum.sample(
        curriculum.init(SIZES),
        jax.random.key(0),
        drawn_goals(np.zeros((4000, 2))),
        view(np.zeros((1, 1, 2)), 0, observation, value, lambda *_: jnp.eye(2)),
    )
    ones = np.asarray(goals.desired[:, 0]).reshape(2, 2000).mean(axis=1)
    np.testing.assert_allclose(ones, [0.0, 0.75], atol=0.03)
    unit = np.std([0.0, 1.0, 2.0])
    np.testing.assert_allclose(goals.memo, unit * np.mean([0, 1, 3, 1]), rtol=1e-5)
    state = curriculum.after_training(curriculum.init(SIZES), outcomes(goals, np.ones(4000)))
    assert curriculum.report(state)["vds_disagreement"] == goals.memo


def test_three_critics_are_the_default() -> None:
    assert hyperparameters(curriculum="vds").agent.critics == 3
    assert hyperparameters(curriculum="vds", critics=1).agent.critics == 1
    assert hyperparameters(curriculum="full").agent.critics == 1


def test_one_critic_cannot_disagree() -> None:
    trainer = make_trainer(PointMass(), TINY)
    with pytest.raises(SettingError, match=r"^critics: 1, but curriculum vds needs 2 or more"):
        trainer.init(tiny(curriculum="vds", critics=1))


def test_a_sweep_gives_each_curriculum_the_critics_it_wants() -> None:
    grid = {"env": ["reach"], "curriculum": ["full", "vds"]}
    for options, expected in (
        ({}, {"full": 1, "vds": 3}),
        ({"critics": [2]}, {"full": 2, "vds": 2}),
    ):
        groups = build_groups("smoke", {**grid, **options})
        runs = [run for group in groups for run in group.runs]
        assert {run.values["curriculum"]: run.values["critics"] for run in runs} == expected
        assert all(run.hyper.agent.critics == run.values["critics"] for run in runs)


@pytest.mark.slow
def test_training_practises_goals_that_critics_disagree_about() -> None:
    values = {"disagreement_power": 4.0}
    trainer, state = walk("vds", Line(), 60, **values)
    hyper = tiny(curriculum="vds", **values)
    _, full = walk("full", Line(), 60)

    def disagreement(goals: jax.Array) -> float:
        where = trainer.setup, hyper, state.normaliser, jnp.zeros((len(goals), 1)), goals
        inputs = network_inputs(*where, jnp.ones_like(goals), jnp.ones(len(goals)))
        action = hyper.agent.act(state.agent, inputs)
        return float(hyper.agent.value(state.agent, inputs, action).std(axis=0).mean())

    ours, theirs = (
        disagreement(states.replay.episodes.desired_goal[-160:]) for states in (state, full)
    )
    assert ours > 1.15 * theirs
