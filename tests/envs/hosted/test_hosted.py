"""Gymnasium's goal environments as tasks; the process in between is left out, where it can be."""

# pyright: reportAttributeAccessIssue=false

from typing import Any

import gymnasium
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from cgm_jax.envs.hosted.rows import Rows, TaskError
from cgm_jax.envs.hosted.task import HostedTask
from cgm_jax.envs.hosted.worker import serve
from cgm_jax.loop.rollout import drawn_goals, reset, roll_out
from tests.envs.hosted import variants
from tests.examples.numpy_point_mass import NumpyPointMass

POINT_MASS = "NumpyPointMass-v0"
SEEDS = np.array([3, 1, 4], np.uint32)


class Direct:
    """In the place of a process."""

    def __init__(self, rows: Rows) -> None:
        self.rows, self.facts, self.requests = rows, rows.facts, []

    def ask(self, op: str, *arrays: np.ndarray) -> list[np.ndarray]:
        self.requests.append((op, len(arrays[0])))
        return serve(self.rows, op, list(arrays))


def alone(seed: int, actions: np.ndarray, env_id: str = POINT_MASS) -> list[np.ndarray]:
    """What one environment shows, stepped by itself."""
    env = gymnasium.make(env_id)
    shown = [env.reset(seed=int(seed))[0]]
    for action in actions:
        *step, _ = env.step(action)
        shown.append(step[0])
        if step[2] or step[3]:
            break
    return [np.asarray(one["observation"], np.float32) for one in shown]


@pytest.fixture(scope="module")
def point_mass() -> Rows:
    return Rows(POINT_MASS)


def test_what_is_known_of_a_task(point_mass: Rows) -> None:
    assert point_mass.facts == {
        "observation_size": 4,
        "goal_size": 2,
        "action_size": 2,
        "episode_length": 25,
        "distance_threshold": 0.1,
        "remarks": [],
    }
    goal = np.zeros((3, 2), np.float32)
    off = np.array([[0.09, 0.0], [0.09, 0.09], [0.0, 0.0]], np.float32)
    assert point_mass.success(off, goal).tolist() == [True, False, True]


def test_rows_are_stepped_as_environments_by_themselves(point_mass: Rows) -> None:
    actions = np.random.default_rng(0).uniform(-1.5, 1.5, (25, 3, 2)).astype(np.float32)
    ticket, batch = point_mass.reset(SEEDS)
    shown = [batch.observation["observation"].copy()]
    for step in range(25):
        tickets, steps = np.full(3, ticket), np.full(3, step)
        ticket, batch = point_mass.step(tickets, steps, SEEDS, actions[step])
        shown.append(batch.observation["observation"].copy())
    for row, seed in enumerate(SEEDS):
        expected = alone(seed, actions[:, row].clip(-1, 1))
        np.testing.assert_array_equal(np.stack(shown)[:, row], expected)


def test_actions_at_the_bounds_lie_within_the_environments_own() -> None:
    rows = Rows("tests/Narrow-v0")  # whose middle plus or minus half lies beyond, in float32
    ticket, batch = rows.reset(SEEDS)
    for step, value in enumerate((-1.0, 1.0, 5.0)):
        actions = np.full((3, 2), value, np.float32)
        ticket, batch = rows.step(np.full(3, ticket), np.full(3, step), SEEDS, actions)
    assert batch.steps == 3


def test_rows_that_serve_several_policies_begin_again_from_their_seeds(point_mass: Rows) -> None:
    ticket, first = point_mass.reset(SEEDS)
    goals = first.observation["desired_goal"].copy()
    point_mass.reset(SEEDS + 100)  # as of goals that are drawn in between
    tickets, steps, seeds = np.full(6, ticket), np.zeros(6, int), np.tile(SEEDS, 2)
    actions = np.repeat(np.array([[1.0, 1.0], [-1.0, 0.0]], np.float32), 3, axis=0)
    _, batch = point_mass.step(tickets, steps, seeds, actions)
    np.testing.assert_array_equal(batch.observation["desired_goal"], np.tile(goals, (2, 1)))
    expected = [alone(seed, action[None])[1] for seed, action in zip(seeds, actions, strict=True)]
    np.testing.assert_array_equal(batch.observation["observation"], expected)


def test_a_state_that_has_passed_cannot_be_stepped_again(point_mass: Rows) -> None:
    ticket, _ = point_mass.reset(SEEDS)
    actions = np.zeros((3, 2), np.float32)
    for step in range(2):
        ticket, _ = point_mass.step(np.full(3, ticket), np.full(3, step), SEEDS, actions)
    tickets = np.full(3, ticket)
    with pytest.raises(TaskError, match="cannot go back"):
        point_mass.step(tickets, np.full(3, 1), SEEDS, actions)
    with pytest.raises(TaskError, match="from different episodes"):
        point_mass.step(tickets, np.full(3, 2), SEEDS + 1, actions)
    # But from its reset on it can.
    _, batch = point_mass.step(tickets, np.zeros(3, int), SEEDS, actions)
    assert batch.steps == 1


def test_resets_that_are_never_stepped_do_not_pile_up(point_mass: Rows) -> None:
    point_mass.step(np.zeros(3), np.zeros(3, int), SEEDS, np.zeros((3, 2)))  # three at a time are
    ticket = [point_mass.reset(SEEDS + number)[0] for number in range(20)][-1]
    tickets = np.full(3, ticket)
    assert point_mass.step(tickets, np.zeros(3, int), SEEDS + 19, np.zeros((3, 2)))[0] == ticket
    assert len([one for one in point_mass._batches.values() if len(one.seeds) == 3]) < 8


def test_a_thousand_goals_that_are_drawn_take_no_thousand_simulators() -> None:
    rows = Rows("tests/Counted-v0")
    seeds, actions = np.arange(1000, dtype=np.uint32), np.zeros((3, 2), np.float32)
    for cycle in range(4):
        ticket, _ = rows.reset(SEEDS)
        for step in range(25):
            ticket, _ = rows.step(np.full(3, ticket), np.full(3, step), SEEDS, actions)
        rows.reset(seeds + 1000 * cycle)
    assert variants.Counted.made < 30
    _, batch = rows.reset(seeds)
    expected = [alone(seed, np.zeros((0, 2)))[0] for seed in seeds[[0, 15, 16, 999]]]
    np.testing.assert_array_equal(batch.observation["observation"][[0, 15, 16, 999]], expected)
    assert len(batch.terminated) == len(batch.seeds) == 1000


def test_environments_whose_reset_fails_are_closed_as_well() -> None:
    rows = Rows("tests/BreakingReset-v0")
    made, closed = variants.Counted.made, variants.Counted.closed
    with pytest.raises(RuntimeError, match="jammed"):
        rows.reset(np.array([1, 666], np.uint32))
    assert variants.Counted.made == made + 2
    rows.close()
    assert variants.Counted.closed == closed + 3


@pytest.mark.parametrize("mode", ["Disabled", "Same_Step", ""])
def test_vector_environments_that_reset_rows_in_another_way_are_not_stepped(mode: str) -> None:
    rows = Rows(f"tests/Resetting{mode}-v0")
    ticket, batch = rows.reset(SEEDS)
    goals = batch.observation["desired_goal"].copy()
    for step in range(25):
        actions = np.zeros((3, 2), np.float32)
        ticket, batch = rows.step(np.full(3, ticket), np.full(3, step), SEEDS, actions)
    assert batch.terminated.all()
    np.testing.assert_array_equal(batch.observation["desired_goal"], goals)


def test_a_reward_of_two_values_is_the_rule_of_success_and_its_reach_is_measured() -> None:
    rows = Rows("tests/OneForSuccess-v0")
    assert rows.facts["distance_threshold"] == pytest.approx(0.2, abs=1e-4)
    off = np.array([[0.29, 0.19], [0.31, 0.0], [0.0, 0.21]], np.float32)
    assert rows.success(off, np.zeros((3, 2), np.float32)).tolist() == [True, False, False]


def test_other_rewards_leave_it_to_the_distance_and_another_is_success_is_remarked_on() -> None:
    rows = Rows("tests/Dense-v0")
    off = np.array([[0.09, 0.0], [0.2, 0.0]], np.float32)
    assert rows.success(off, np.zeros((2, 2), np.float32)).tolist() == [True, False]
    (remark,) = rows.facts["remarks"]
    assert remark == (
        "success is judged by distance_threshold of tests/Dense-v0, not by is_success"
    )


@pytest.mark.parametrize("name", ["Still", "OneStep", "Constant"])
def test_an_episode_that_shows_one_distance_alone_does_not_make_a_reward_a_rule(name: str) -> None:
    rows = Rows(f"tests/{name}-v0")
    assert rows.facts["distance_threshold"] == 0.1
    off = np.array([[0.0, 0.0], [0.04, 0.0], [0.09, 0.0], [0.11, 0.0]], np.float32)
    expected = [True, True, True, False]
    assert rows.success(off, np.zeros((4, 2), np.float32)).tolist() == expected
    assert [one for one in rows.facts["remarks"] if "success is judged" in one] == []


def test_a_reward_that_knows_no_goals_far_away_can_be_the_rule() -> None:
    assert Rows("tests/Walled-v0").facts["distance_threshold"] == pytest.approx(0.2, abs=1e-4)


def test_a_reward_that_fails_leaves_it_to_the_distance() -> None:
    rows = Rows("tests/Unwritten-v0")
    assert (rows.facts["distance_threshold"], rows.facts["remarks"]) == (0.1, [])
    off = np.array([[0.09, 0.0], [0.11, 0.0]], np.float32)
    assert rows.success(off, np.zeros((2, 2), np.float32)).tolist() == [True, False]


REFUSED = {
    "CartPole-v1": "CartPole-v1 is no goal environment: it lacks observation",
    "Nothing-v0": r"Nothing.* \(gymnasium:MODULE:ID imports a module first\)",
    "tests/Endless-v0": "tests/Endless-v0 has no max_episode_steps",
    "tests/NoRule-v0": "has neither a compute_reward of two values nor a distance_threshold",
    "tests/TrueThreshold-v0": "has neither a compute_reward of two values nor a distance_threshold",
    "tests/ReadingInfo-v0": (
        "tests/ReadingInfo-v0 has neither a compute_reward of two values nor a distance_threshold; "
        "compute_reward fails with KeyError: 'is_success'"
    ),
    "tests/MovingGoal-v0": "step of tests/MovingGoal-v0 changes desired_goal, which holds for an",
    "tests/OtherGoals-v0": (
        r"achieved_goal of tests/OtherGoals-v0 has shape \(2,\) and desired_goal \(3,\)"
    ),
    "tests/OtherShape-v0": (
        r"observation of tests/OtherShape-v0 has shape \(2,\), its space says \(4,\)"
    ),
    "tests/WholeActions-v0": "actions of tests/WholeActions-v0 are int64, not floating-point",
    "tests/FarAway-v0": "of tests/FarAway-v0, 0.1, is less than float32 can tell apart at a",
}


@pytest.mark.parametrize("env_id", REFUSED)
@pytest.mark.filterwarnings("ignore:.*The obs returned by the")
def test_what_cannot_be_trained_on_is_refused_in_one_line(env_id: str) -> None:
    with pytest.raises(TaskError, match=REFUSED[env_id]) as refusal:
        Rows(env_id)
    assert "\n" not in str(refusal.value)


REMARKED_ON = {
    "CutShort": (
        "{} itself cuts an episode off after 10 of its 25 steps; "
        "episodes with which it does that are dropped"
    ),
    "Drawn": "reset and step of {} give other values for the same seed and action; what is trained",
    "DrawnLater": "reset and step of {} give other values for the same seed and action; what is",
    "Crashing": "{} ended an episode without success; where a step costs 1 and nothing comes after",
    "NotFinite": "observation is not finite after step of {}; episodes in which that happens are",
}


@pytest.mark.parametrize("name", REMARKED_ON)
@pytest.mark.filterwarnings("ignore:.*The obs returned by the")
def test_what_is_hardly_meant_is_remarked_on(name: str) -> None:
    (remark,) = Rows(f"tests/{name}-v0").facts["remarks"]
    assert remark.startswith(REMARKED_ON[name].format(f"tests/{name}-v0"))


def forward(observation: jax.Array, goal: jax.Array, noise: Any) -> jax.Array:
    del noise
    return jnp.clip(4.0 * (goal - observation[..., :2]), -1.0, 1.0)


def play(task: HostedTask, mask: list[float], count: int = 4) -> Any:
    """Two runs of so many episodes each."""

    def run(key: jax.Array) -> Any:
        first = reset(task, key, count)  # pyright: ignore[reportArgumentType]
        goals = drawn_goals(task, first)  # pyright: ignore[reportArgumentType]
        goals = goals.replace(mask=jnp.broadcast_to(jnp.array(mask), goals.mask.shape))
        return roll_out(task, forward, first, goals)  # pyright: ignore[reportArgumentType]

    return jax.jit(jax.vmap(run))(jax.random.split(jax.random.key(0), 2))


def test_episodes_inside_a_compiled_program_take_one_request_a_step_for_all_runs(
    point_mass: Rows,
) -> None:
    direct = Direct(point_mass)
    task = HostedTask(direct)  # pyright: ignore[reportArgumentType]
    rollout = play(task, [1.0, 1.0])
    assert [one for one in direct.requests if one[0] == "step"] == [("step", 8)] * 25
    again = play(task, [1.0, 1.0])
    np.testing.assert_array_equal(rollout.episodes.observation, again.episodes.observation)
    assert rollout.outcomes.success.all()
    assert rollout.outcomes.valid.all()
    off = np.asarray(rollout.episodes.achieved_goal[:, :, -1] - rollout.episodes.desired_goal)
    threshold = NumpyPointMass.distance_threshold
    assert (np.linalg.norm(off, axis=-1) < threshold).all()
    keys = jax.vmap(lambda key: jax.random.split(key, 4))(jax.random.split(jax.random.key(0), 2))
    seed = int(jax.random.bits(keys[1, 2], dtype=jnp.uint32) >> 1)
    actions = np.asarray(rollout.episodes.action[1, 2])
    expected = alone(seed, actions)
    np.testing.assert_array_equal(rollout.episodes.observation[1, 2], np.stack(expected))


def test_a_masked_dimension_counts_as_achieved_by_the_environments_own_rule(
    point_mass: Rows,
) -> None:
    task = HostedTask(Direct(point_mass))  # pyright: ignore[reportArgumentType]
    rollout = play(task, [1.0, 0.0])
    off = np.abs(rollout.episodes.achieved_goal[:, :, -1] - rollout.episodes.desired_goal)
    np.testing.assert_array_equal(rollout.outcomes.success, off[..., 0] < 0.1)
    np.testing.assert_array_equal(rollout.outcomes.subgoal_success, off < 0.1)
    assert rollout.outcomes.success.all()
    assert not rollout.outcomes.subgoal_success.all()


def test_what_terminates_ends_and_what_is_cut_off_early_is_dropped() -> None:
    task = HostedTask(Direct(Rows("tests/Ending-v0")))  # pyright: ignore[reportArgumentType]
    rollout = jax.tree.map(np.asarray, play(task, [1.0, 1.0], 20))
    episodes, outcomes = rollout.episodes, rollout.outcomes
    position, goal = episodes.observation[..., 0, 0], episodes.desired_goal[..., 0]
    end = 3 + np.floor(np.abs(position) * 40).astype(int)
    cut = (goal < 0.0) & (end < 25)
    np.testing.assert_array_equal(outcomes.valid, ~cut)
    expected = np.where((end <= 25) & (goal >= 0.0), end, 26)
    np.testing.assert_array_equal(episodes.length[~cut], expected[~cut])
    assert cut.any()
    assert (episodes.length < 25).any()
    for place in np.argwhere(episodes.length < 25):
        after = episodes.observation[tuple(place)][episodes.length[tuple(place)] :]
        np.testing.assert_array_equal(after, np.broadcast_to(after[0], after.shape))
