import jax
import jax.numpy as jnp
import numpy as np
import pytest

from cgm_jax.envs import Stage
from cgm_jax.replay.protocol import Transitions
from cgm_jax.replay.relay import Relay
from cgm_jax.replay.ring import Episodes, Replay, init_replay, insert
from tests.examples.crane import Crane

EPISODES, LENGTH, COUNT, THRESHOLD = 4, 6, 40_000, 0.05

# Of observations (episode, step, x, y, z): two stages, about x and about (y, z).
STAGES = (
    Stage(lambda o: o[2:3], lambda o, g: g[:1], 1, 0.3),
    Stage(lambda o: o[3:5], lambda o, g: o[2:3] + g, 2, 0.5),
)


def make_replay() -> tuple[Replay, np.ndarray]:
    """Stages achieve another value at every step; only episode 0 moved its achieved goal."""
    generator = np.random.default_rng(0)
    places = np.stack(np.meshgrid(range(EPISODES), range(LENGTH + 1), indexing="ij"), -1)
    values = generator.uniform(0.0, 1.0, (EPISODES, LENGTH + 1, 3))
    observation = np.concatenate([places, values], axis=-1).astype(np.float32)
    achieved = np.zeros((EPISODES, LENGTH + 1, 2), np.float32)
    achieved[0, 1:] = 1.0
    episodes = Episodes(
        observation=jnp.asarray(observation),
        achieved_goal=jnp.asarray(achieved),
        action=jnp.zeros((EPISODES, LENGTH, 1)),
        desired_goal=jnp.full((EPISODES, 2), 9.0),
        mask=jnp.ones((EPISODES, 2)),
        threshold=jnp.full(EPISODES, THRESHOLD),
    )
    replay = init_replay(EPISODES + 2, LENGTH, 5, 2, 1)
    return insert(replay, episodes, jnp.ones(EPISODES, bool)), observation


def draw(relay: Relay) -> tuple[Transitions, np.ndarray]:
    replay, observation = make_replay()
    drawn = relay.sample(jax.random.key(1), replay, COUNT, THRESHOLD, STAGES)
    return jax.tree.map(np.asarray, drawn), observation


def remaining(target: np.ndarray, achieved: np.ndarray, threshold: float) -> np.ndarray:
    return np.clip((target - achieved) / (2.0 * threshold), -5.0, 5.0)


# Hindsight asks for half of a stage's threshold.
def test_hindsight_serves_every_stage_with_what_it_achieved_later() -> None:
    drawn, observation = draw(Relay(her_k=1e6, relay_share=1.0))
    assert drawn.subgoal is not None
    assert drawn.next_subgoal is not None
    first = drawn.subgoal[:, 0] == 1
    np.testing.assert_array_equal(drawn.subgoal[:, 1], np.where(first, 0.0, 1.0))
    assert first.mean() == pytest.approx(0.5, abs=0.011)  # over four standard errors
    rewards, futures = [], np.zeros((LENGTH, LENGTH + 1))
    for row in np.flatnonzero(first)[:500]:
        episode, step = drawn.observation[row, :2].astype(int)
        now, after = observation[episode, step, 2], observation[episode, step + 1, 2]
        # The later step is found by what it achieved, which is shown less what is achieved now.
        later = observation[episode, step + 1 :, 2]
        candidates = remaining(later, now, 0.3)
        (match,) = np.flatnonzero(np.isclose(candidates, drawn.subgoal[row, 2], atol=1e-6))
        futures[step, step + 1 + match] += 1
        target = later[match]
        assert drawn.reward[row] == (0.0 if abs(target - after) < 0.15 else -1.0)
        shown = np.array([1, 0, remaining(target, after, 0.3), 0, 0])
        np.testing.assert_allclose(drawn.next_subgoal[row], shown, atol=1e-6)
        rewards.append(drawn.reward[row])
    assert {0.0, -1.0} == set(rewards)
    assert (futures[np.triu_indices(LENGTH, 1, LENGTH + 1)] > 0).all()
    assert (futures[np.tril_indices(LENGTH, 0, LENGTH + 1)] == 0).all()


def test_a_stage_of_two_dimensions_is_judged_by_distance() -> None:
    drawn, observation = draw(Relay(her_k=1e6, relay_share=1.0))
    assert drawn.subgoal is not None
    second = np.flatnonzero(drawn.subgoal[:, 1] == 1)[:500]
    episode, step = drawn.observation[second, :2].astype(int).T
    now, after = (observation[episode, step + i, 3:5] for i in (0, 1))
    target = now + 2.0 * 0.5 * drawn.subgoal[second, 3:5]  # nothing is clipped
    expected = np.where(np.linalg.norm(target - after, axis=-1) < 0.25, 0.0, -1.0)
    np.testing.assert_array_equal(drawn.reward[second], expected)
    assert 0.1 < (expected == 0).mean() < 0.9, "both occur"


def test_the_share_is_of_hindsight_and_stages_come_from_all_episodes() -> None:
    drawn, _ = draw(Relay(her_k=3.0, her_filter=True, relay_share=0.4))
    assert drawn.subgoal is not None
    staged = drawn.subgoal[:, :2].sum(axis=1) == 1
    own = drawn.goal[:, 0] == 9.0
    # Of four transitions one keeps its episode's goal, and of the others 40 % serve a stage.
    assert staged.mean() == pytest.approx(0.75 * 0.4, abs=0.011)
    assert (own & ~staged).mean() == pytest.approx(0.25, abs=0.011)
    episode = drawn.observation[:, 0].astype(int)
    np.testing.assert_allclose(np.bincount(episode[staged]) / staged.sum(), 0.25, atol=0.02)
    assert set(episode[~staged & ~own]) == {0}  # the one that moved
    np.testing.assert_array_equal(drawn.subgoal[~staged], 0.0)


def test_without_a_share_no_transition_serves_a_stage() -> None:
    drawn, _ = draw(Relay(relay_share=0.0))
    assert drawn.subgoal is not None
    np.testing.assert_array_equal(drawn.subgoal, 0.0)
    np.testing.assert_array_equal(drawn.next_subgoal, 0.0)


@pytest.mark.parametrize(
    ("load", "held", "expected"),
    [
        ([0.5, -0.1], 0.0, [1, 0, 0.0 - 0.3 / 0.2, 0.5, 0]),
        ([0.25, 0.0], 0.0, [0, 1, 0, 0, 1.0]),  # within reach, but open
        ([0.25, 0.0], 1.0, [0, 0, 0, 0, 0]),
        ([-1.0, 0.0], 1.0, [1, 0, 5.0, 0.0, 0]),  # clipped; the later stage does not excuse
    ],
)
def test_exploration_pursues_the_first_stage_that_is_not_achieved(
    load: list[float], held: float, expected: list[float]
) -> None:
    observation = jnp.array([0.2, 0.0, *load, held])
    pursued = Relay().pursued(
        Crane().stages, observation[None], jnp.zeros((1, 2)), jnp.array([0.49])
    )
    np.testing.assert_allclose(pursued[0], expected, atol=1e-6)


def test_what_is_pursued_agrees_with_numpy() -> None:
    generator = np.random.default_rng(3)
    observation = generator.uniform(0.0, 1.0, (150, 5)).astype(np.float32)
    goal = generator.uniform(0.0, 1.0, (150, 2)).astype(np.float32)
    expected = np.zeros((150, 5))
    for i, (seen, wanted) in enumerate(zip(observation, goal, strict=True)):
        x, y = wanted[:1] - seen[2:3], seen[2:3] + wanted - seen[3:5]
        if np.linalg.norm(x) >= 0.3:
            expected[i] = [1, 0, *np.clip(x / 0.6, -5, 5), 0, 0]
        elif np.linalg.norm(y) >= 0.5:
            expected[i] = [0, 1, 0, *np.clip(y / 1.0, -5, 5)]
    uniform = jnp.full(150, 0.49)
    pursued = Relay().pursued(STAGES, jnp.asarray(observation), jnp.asarray(goal), uniform)
    np.testing.assert_allclose(pursued, expected, atol=1e-6)
    assert {0.0, 1.0, 2.0} == set(expected[:, 0] + 2 * expected[:, 1])


def test_by_chance_the_goal_is_pursued_instead() -> None:
    observation = jnp.tile(jnp.array([0.2, 0.0, -1.0, 0.0, 0.0]), (4, 1))  # far from the load
    uniform = jnp.array([0.0, 0.29, 0.31, 0.99])
    for chance, guided in ((1.0, [1, 1, 1, 1]), (0.3, [1, 1, 0, 0]), (0.0, [0, 0, 0, 0])):
        relay = Relay(relay_chance=chance)
        pursued = relay.pursued(Crane().stages, observation, jnp.zeros((4, 2)), uniform)
        np.testing.assert_array_equal(pursued[:, 0], guided)
        np.testing.assert_array_equal(pursued.any(axis=1), guided)


def test_without_hindsight_no_stage_is_pursued_nor_served() -> None:
    assert Relay().idle() == frozenset()
    relay = Relay(her=False, relay_chance=1.0, relay_share=1.0)
    assert {"relay_share", "relay_chance"} <= relay.idle()
    observation = jnp.array([[0.2, 0.0, -1.0, 0.0, 0.0]])  # far from the load
    pursued = relay.pursued(Crane().stages, observation, jnp.zeros((1, 2)), jnp.zeros(1))
    np.testing.assert_array_equal(pursued, 0.0)
    assert draw(relay)[0].subgoal is not None
    np.testing.assert_array_equal(draw(relay)[0].subgoal, 0.0)
