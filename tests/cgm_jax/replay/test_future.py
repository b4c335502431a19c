import jax
import jax.numpy as jnp
import numpy as np
import pytest

from cgm_jax.replay.future import MIN_MOTION, Future
from cgm_jax.replay.protocol import Transitions
from cgm_jax.replay.ring import Episodes, Replay, init_replay, insert

EPISODES, LENGTH, GOAL = 5, 10, 3
THRESHOLD = 0.05
COUNT = 40_000


def make_replay() -> tuple[Replay, Episodes]:
    """Random achieved goals; observation (episode, step) and action (episode, step) encoded."""
    generator = np.random.default_rng(0)
    numbers, steps = np.arange(EPISODES), np.arange(LENGTH + 1)
    codes = np.stack(np.meshgrid(numbers, steps, indexing="ij"), -1).astype(np.float32)
    # A coarse lattice, so that different steps often achieve the same goal.
    achieved = 0.04 * generator.integers(0, 3, (EPISODES, LENGTH + 1, GOAL))
    episodes = Episodes(
        observation=jnp.asarray(codes),
        achieved_goal=jnp.asarray(achieved, jnp.float32),
        action=jnp.asarray(codes[:, :-1]),
        desired_goal=jnp.asarray(0.04 * generator.integers(0, 3, (EPISODES, GOAL)), jnp.float32),
        mask=jnp.asarray(generator.integers(0, 2, (EPISODES, GOAL)), jnp.float32),
        threshold=jnp.full(EPISODES, THRESHOLD),
    )
    replay = init_replay(EPISODES + 3, LENGTH, 2, GOAL, 2)
    return insert(replay, episodes, jnp.ones(EPISODES, bool)), episodes


OWN, HINDSIGHT = Future(her=False), Future(her_k=1e6)
"""No transition is relabelled, or as good as all."""


def draw(future: Future) -> tuple[dict[str, np.ndarray], Episodes]:
    replay, episodes = make_replay()
    transitions: Transitions = future.sample(jax.random.key(1), replay, COUNT, THRESHOLD)
    names = Transitions.__dataclass_fields__
    return {name: np.asarray(getattr(transitions, name)) for name in names}, episodes


def test_transitions_are_uniform_over_episodes_and_steps() -> None:
    transitions, _ = draw(OWN)
    episode, step = transitions["observation"].astype(int).T
    counts = np.zeros((EPISODES, LENGTH))
    np.add.at(counts, (episode, step), 1)
    expected = COUNT / (EPISODES * LENGTH)
    chi_square = np.sum((counts - expected) ** 2 / expected)
    assert chi_square < 85.4  # 99.9 % quantile at 49 degrees of freedom
    np.testing.assert_array_equal(transitions["action"], transitions["observation"])
    np.testing.assert_array_equal(
        transitions["next_observation"], transitions["observation"] + [0, 1]
    )


@pytest.mark.parametrize("k", [0.0, 1e6])
@pytest.mark.parametrize("filtered", [False, True])
def test_transitions_are_uniform_where_episodes_end_early(filtered: bool, k: float) -> None:
    _, episodes = make_replay()
    episodes = episodes.replace(length=jnp.array([1, 10, 11, 4, 7]))
    replay = init_replay(EPISODES + 3, LENGTH, 2, GOAL, 2, may_end=True)
    replay = insert(replay, episodes, jnp.ones(EPISODES, bool))
    future = Future(her_k=k, her_filter=filtered)
    drawn = future.sample(jax.random.key(1), replay, COUNT, THRESHOLD)
    episode, step = np.asarray(drawn.observation).astype(int).T
    counts = np.zeros((EPISODES, LENGTH))
    np.add.at(counts, (episode, step), 1)
    taken = np.arange(LENGTH) < np.array([[1], [10], [10], [4], [7]])
    assert (counts[~taken] == 0).all()
    expected = COUNT / 32
    chi_square = np.sum((counts[taken] - expected) ** 2 / expected)
    assert chi_square < 61.1  # 99.9 % quantile at 31 degrees of freedom


def test_without_her_goals_and_masks_are_the_episodes_own() -> None:
    transitions, episodes = draw(OWN)
    episode, step = transitions["observation"].astype(int).T
    achieved, mask = np.asarray(episodes.achieved_goal), np.asarray(episodes.mask)[episode]
    goal = np.asarray(episodes.desired_goal)[episode]
    now, after = achieved[episode, step], achieved[episode, step + 1]
    np.testing.assert_array_equal(transitions["goal"], goal * mask + now * (1 - mask))
    np.testing.assert_array_equal(transitions["next_goal"], goal * mask + after * (1 - mask))
    reached = np.linalg.norm(mask * (after - goal), axis=-1) < THRESHOLD
    np.testing.assert_array_equal(transitions["reward"], np.where(reached, 0.0, -1.0))
    assert 0.1 < reached.mean() < 0.9


def test_with_her_goals_come_uniformly_from_later_steps_and_rewards_follow() -> None:
    # Distinct achieved goals reveal which step a goal came from.
    replay, episodes = make_replay()
    distinct = jnp.arange(EPISODES * (LENGTH + 1) * GOAL, dtype=jnp.float32)
    distinct = distinct.reshape(EPISODES, LENGTH + 1, GOAL)
    episodes = episodes.replace(achieved_goal=distinct)
    replay = insert(init_replay(EPISODES, LENGTH, 2, GOAL, 2), episodes, jnp.ones(EPISODES, bool))
    transitions = HINDSIGHT.sample(jax.random.key(2), replay, COUNT, THRESHOLD)
    episode, step = np.asarray(transitions.observation).astype(int).T
    row = np.asarray(transitions.goal)[:, 0].astype(int) // GOAL
    assert (row // (LENGTH + 1) == episode).all()
    future = row % (LENGTH + 1)
    assert (future > step).all()
    assert (future <= LENGTH).all()
    for start in range(LENGTH):
        counts = np.bincount(future[step == start], minlength=LENGTH + 1)[start + 1 :]
        expected = counts.sum() / len(counts)
        deviation = np.abs(counts - expected)
        assert (deviation < 4.5 * np.sqrt(expected)).all(), f"step {start}: {counts}"
    # A goal of distinct places is reached exactly where it was taken from the next step.
    np.testing.assert_array_equal(
        np.asarray(transitions.reward), np.where(future == step + 1, 0.0, -1.0)
    )


def test_relabelled_goals_are_not_masked() -> None:
    transitions, episodes = draw(HINDSIGHT)
    np.testing.assert_array_equal(transitions["goal"], transitions["next_goal"])
    assert (np.asarray(episodes.mask) == 0).any()


def test_hindsight_with_masks_keeps_the_episodes_own() -> None:
    transitions, episodes = draw(Future(her_k=1e6, her_masks=True))
    episode, step = transitions["observation"].astype(int).T
    mask = np.asarray(episodes.mask)[episode]
    np.testing.assert_array_equal(transitions["mask"], mask)
    now = np.asarray(episodes.achieved_goal)[episode, step]
    np.testing.assert_array_equal(transitions["goal"][mask == 0], now[mask == 0])
    whole, _ = draw(HINDSIGHT)
    assert (whole["mask"] == 1).all()
    assert (transitions["goal"] != whole["goal"]).any()


def test_rewards_are_judged_at_the_episodes_own_threshold() -> None:
    replay, episodes = make_replay()
    wide = episodes.replace(threshold=jnp.where(jnp.arange(EPISODES) < 2, 1.0, THRESHOLD))
    replay = insert(init_replay(EPISODES, LENGTH, 2, GOAL, 2), wide, jnp.ones(EPISODES, bool))
    transitions = OWN.sample(jax.random.key(5), replay, COUNT, THRESHOLD)
    episode = np.asarray(transitions.observation)[:, 0]
    reward = np.asarray(transitions.reward)
    assert (reward[episode < 2] == 0).all()
    assert (reward[episode >= 2] == -1).any()


@pytest.mark.parametrize("k", [1.0, 6.0])
def test_the_share_of_relabelled_transitions_is_k_of_k_plus_one(k: float) -> None:
    replay, episodes = make_replay()
    far = episodes.replace(desired_goal=jnp.full((EPISODES, GOAL), 9.0), mask=jnp.ones((5, 3)))
    replay = insert(init_replay(EPISODES, LENGTH, 2, GOAL, 2), far, jnp.ones(EPISODES, bool))
    transitions = Future(her_k=k).sample(jax.random.key(3), replay, COUNT, THRESHOLD)
    share = np.mean(np.asarray(transitions.goal)[:, 0] != 9.0)
    assert share == pytest.approx(k / (k + 1), abs=0.011)  # over four standard errors


def draw_filtered(moved: list[bool], k: float) -> tuple[np.ndarray, np.ndarray]:
    """Which episodes were drawn, and whether they were relabelled.

    An episode that moved strays just over the least distance at a single step.
    """
    _, episodes = make_replay()
    achieved = np.zeros((EPISODES, LENGTH + 1, GOAL), np.float32)
    achieved[:, 4, 1] = MIN_MOTION * THRESHOLD * np.where(moved, 1.01, 0.99)
    episodes = episodes.replace(
        achieved_goal=jnp.asarray(achieved),
        desired_goal=jnp.full((EPISODES, GOAL), 9.0),
        mask=jnp.ones((EPISODES, GOAL)),
    )
    replay = init_replay(EPISODES + 3, LENGTH, 2, GOAL, 2)
    replay = insert(replay, episodes, jnp.ones(EPISODES, bool))
    filtered = Future(her_k=k, her_filter=True)
    transitions = filtered.sample(jax.random.key(4), replay, COUNT, THRESHOLD)
    return (
        np.asarray(transitions.observation)[:, 0].astype(int),
        np.asarray(transitions.goal)[:, 0] != 9.0,
    )


def test_the_filter_relabels_only_episodes_that_moved_and_those_uniformly() -> None:
    episode, relabelled = draw_filtered([False, True, False, True, True], 3.0)
    assert relabelled.mean() == pytest.approx(0.75, abs=0.011)
    with_hindsight = np.bincount(episode[relabelled], minlength=EPISODES) / relabelled.sum()
    np.testing.assert_allclose(with_hindsight, [0, 1 / 3, 0, 1 / 3, 1 / 3], atol=0.015)
    with_own_goal = np.bincount(episode[~relabelled], minlength=EPISODES) / (~relabelled).sum()
    np.testing.assert_allclose(with_own_goal, np.full(EPISODES, 0.2), atol=0.02)


def test_the_filter_gives_way_while_no_episode_has_moved() -> None:
    episode, relabelled = draw_filtered([False] * EPISODES, 1e6)
    assert relabelled.all()
    counts = np.bincount(episode, minlength=EPISODES + 3) / COUNT  # never an empty slot
    np.testing.assert_allclose(counts, [0.2] * EPISODES + [0] * 3, atol=0.01)
