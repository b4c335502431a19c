"""An environment's own rules: tolerance, success, reward, and where an episode ends."""

# pyright: reportAttributeAccessIssue=false, reportIndexIssue=false, reportOptionalMemberAccess=false

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from brax.envs.base import State

from cgm_jax.agents.ddpg import DDPG
from cgm_jax.config.fields import SettingError, settings, stack
from cgm_jax.curricula.accuracy import Accuracy
from cgm_jax.curricula.protocol import Curriculum, Goals, View
from cgm_jax.envs import Stage
from cgm_jax.loop.cycle import plan
from cgm_jax.loop.environment import remarks_on
from cgm_jax.loop.judging import rewards, subgoals_succeed, succeeds
from cgm_jax.loop.learning import minibatches
from cgm_jax.loop.own_checks import checked
from cgm_jax.loop.rollout import Rollout, drawn_goals, reset, roll_out
from cgm_jax.loop.setup import init_state, make_setup
from cgm_jax.loop.training import make_trainer
from cgm_jax.replay.future import Future
from cgm_jax.replay.ring import insert
from tests.cgm_jax.agents.oracle import SIZES, action_value, example_batch, in_numpy
from tests.cgm_jax.own_environments import Base
from tests.cgm_jax.probe import TINY, tiny
from tests.cgm_jax.protocols import assert_no_type_is_promoted

END = 0.4
TOLERANCE = np.array([0.1, 0.4])


class Ruled(Base):
    """A point that may be off farther in y than in x; its episode ends where x exceeds `END`."""

    episode_length = 12
    goal_tolerance = TOLERANCE
    reward_range = (-3.0, 1.0)

    def goal_reward(self, achieved_goal: jax.Array, desired_goal: jax.Array) -> jax.Array:
        return 1.0 - jnp.minimum(jnp.abs(achieved_goal - desired_goal).sum(), 4.0)

    def is_terminal(self, state: State) -> jax.Array:
        return state.obs["achieved_goal"][0] > END


class Drifting(Ruled):
    """It goes to the right by itself, and may begin anywhere."""

    def restart(self, state: State) -> State:
        return state

    def step(self, state: State, action: jax.Array) -> State:
        return super().step(state, action + 0.5)


class Square(Base):
    """Success within a square, as a rule of its own."""

    def goal_success(self, achieved_goal: jax.Array, desired_goal: jax.Array) -> jax.Array:
        return jnp.abs(achieved_goal - desired_goal).max() < 0.3


@pytest.fixture(scope="module")
def env() -> Any:
    return checked(Ruled(), "Ruled")


@pytest.mark.parametrize("env", [Ruled(), checked(Ruled(), "Ruled")], ids=["raw", "checked"])
def test_distance_is_measured_in_tolerances_and_masked_dimensions_count_as_achieved(
    env: Any,
) -> None:
    goal = jnp.zeros((4, 2))
    achieved = jnp.array([[0.09, 0.1], [0.09, 0.3], [0.0, 0.39], [0.2, 0.2]])
    full, only_y = jnp.ones((4, 2)), jnp.tile(jnp.array([0.0, 1.0]), (4, 1))
    # (0.9, 0.25), (0.9, 0.75), (0, 0.975), (2, 0.5) tolerances off.
    expected = [True, False, True, False]
    assert succeeds(env, goal, full, achieved, jnp.ones(4)).tolist() == expected
    assert succeeds(env, goal, only_y, achieved, jnp.ones(4)).tolist() == [True] * 4
    subgoals = [[True, True], [True, True], [True, True], [False, True]]
    assert subgoals_succeed(env, goal, achieved, 0.1).tolist() == subgoals


def test_a_rule_of_success_is_asked_about_masked_goals() -> None:
    square: Any = checked(Square(), "Square")
    goal = jnp.zeros((2, 2))
    achieved = jnp.array([[0.29, -0.29], [0.1, 0.31]])  # farther than the threshold, all of them
    full, only_x = jnp.ones((2, 2)), jnp.tile(jnp.array([1.0, 0.0]), (2, 1))
    assert succeeds(square, goal, full, achieved, jnp.ones(2)).tolist() == [True, False]
    assert succeeds(square, goal, only_x, achieved, jnp.ones(2)).tolist() == [True, True]
    assert subgoals_succeed(square, goal, achieved, 0.1).tolist() == [[True, True], [True, False]]


def right(observation: jax.Array, goal: jax.Array, noise: Any) -> jax.Array:
    del goal, noise
    return jnp.broadcast_to(jnp.array([1.0, 0.0]), observation.shape)


@pytest.fixture(scope="module")
def played(env: Any) -> Rollout:
    """Episodes in which the point goes to the right."""
    first = reset(env, jax.random.key(0), 32)
    return jax.jit(lambda state: roll_out(env, right, state, drawn_goals(env, state)))(first)


def test_an_episode_that_ends_stays_where_it_ended(played: Rollout) -> None:
    achieved, length = (
        np.asarray(part) for part in (played.episodes.achieved_goal, played.episodes.length)
    )
    steps = np.ceil((END - achieved[:, 0, 0]) / 0.1).clip(0)  # a tenth to the right at each
    off_boundary = np.abs((END - achieved[:, 0, 0]) / 0.1 % 1 - 0.5) < 0.49  # rounding decides
    np.testing.assert_array_equal(
        length[off_boundary], np.where(steps > 12, 13, steps)[off_boundary]
    )
    np.testing.assert_array_equal(played.outcomes.valid, length > 0)
    assert (length == 13).any()
    assert (length == 0).any()
    for episode, end in zip(achieved, np.minimum(length, 12), strict=True):
        np.testing.assert_allclose(np.diff(episode[: end + 1, 0]), 0.1, atol=1e-6)
        np.testing.assert_array_equal(episode[end:], np.broadcast_to(episode[end], (13 - end, 2)))


def test_visited_is_any_state_after_a_step_that_did_not_end_the_episode() -> None:
    ruled: Any = Ruled()
    starts = jnp.array([0.05, -2.0, 0.35, 0.55])  # they end after 4 steps, never, after 1, at once
    first = jax.vmap(lambda x: ruled.state(jnp.stack([x, x]), jnp.ones(2)))(starts.repeat(4000))
    goals = drawn_goals(ruled, first)
    rollout = jax.jit(
        lambda state: roll_out(ruled, right, state, goals, visit_key=jax.random.key(3))
    )(first)
    moved = np.asarray(rollout.outcomes.visited.obs["achieved_goal"][:, 0] - starts.repeat(4000))
    steps = np.rint(10 * moved).astype(int).reshape(4, 4000)  # a tenth at each
    shares = [np.bincount(row, minlength=13) / 4000 for row in steps]
    np.testing.assert_allclose(shares[0][:4], [0, 1 / 3, 1 / 3, 1 / 3], atol=0.03)
    np.testing.assert_allclose(shares[1], [0, *[1 / 12] * 12], atol=0.02)
    assert shares[2][0] == 1.0  # the state before: there is no other
    valid, broken = (
        np.asarray(x).reshape(4, 4000) for x in (rollout.outcomes.valid, rollout.broken)
    )
    assert valid.all(axis=1).tolist() == [True, True, True, False]
    assert not valid[3].any()
    assert not broken.any()


def test_starts_are_never_where_an_episode_ends() -> None:
    trainer = make_trainer(checked(Drifting(), "Drifting"), TINY)
    hyper = tiny(curriculum="starts", reset_share=0.0, random_action_probability=1.0)
    train = jax.jit(lambda state, cycles: trainer.train(state, hyper, cycles))
    once = train(trainer.init(hyper), 1)
    several = train(once, 6)
    assert 0 < int(once.replay.inserted) < 8  # some resets are beyond the end
    assert int(several.replay.inserted - once.replay.inserted) == 6 * 8  # no start is
    visited = several.curriculum.visited
    assert int(visited.recorded) == int(several.replay.inserted)
    achieved = np.asarray(visited.rows.obs["achieved_goal"])[np.asarray(visited.filled)]
    assert (achieved[:, 0] <= END).all()
    assert (np.asarray(several.replay.episodes.length)[: int(visited.recorded)] < 13).any()


def test_episodes_that_end_before_their_first_step_are_dropped_but_not_as_broken(env: Any) -> None:
    trainer = make_trainer(env, TINY)
    hyper = tiny(curriculum="cgm", masked_evaluation_episodes=4)
    state, metrics = jax.jit(trainer.evaluate)(trainer.init(hyper), hyper)
    assert int(metrics["evaluated_episodes"]) < TINY.evaluation_episodes
    assert state.curriculum.masks.inserted.min() < 4
    assert float(metrics["physics_warnings"]) == 0.0


def test_curricula_see_after_how_many_steps_episodes_were_over(env: Any, played: Rollout) -> None:
    seen: list[jax.Array | None] = []

    class Looking(Curriculum[Any]):
        def sample(self, state: Any, key: jax.Array, drawn: Goals, view: View) -> Goals:
            seen.append(view.steps)
            return drawn

    hyper = dataclasses.replace(tiny(), curriculum=Looking())
    setup = make_setup(env, TINY)
    state = init_state(setup, tiny())
    replay = insert(state.replay, played.episodes, played.outcomes.valid)
    plan(setup, state.replace(replay=replay), hyper)
    endless = make_setup(checked(Square(), "Square"), TINY)
    plan(endless, init_state(endless, tiny()), hyper)
    length = np.asarray(played.episodes.length)
    expected = np.minimum(length[length > 0], 12)
    steps, none = seen
    assert steps is not None
    assert none is None
    np.testing.assert_array_equal(steps[: len(expected)], expected)
    assert len(set(expected)) > 4


def test_agents_learn_from_the_environments_rewards_and_not_beyond_its_ends(
    env: Any, played: Rollout
) -> None:
    setup, hyper = make_setup(env, TINY), tiny(her_k=2.0)
    state = init_state(setup, hyper)
    outcomes = played.outcomes
    state = state.replace(replay=insert(state.replay, played.episodes, outcomes.valid))
    key = jax.random.key(7)
    batch = minibatches(setup, state, hyper, key)
    count = TINY.updates_per_cycle * TINY.batch_size
    drawn = hyper.relabelling.sample(key, state.replay, count, setup.env.distance_threshold)
    achieved, goal, mask = (
        np.asarray(part) for part in (drawn.next_achieved, drawn.next_goal, drawn.mask)
    )
    np.testing.assert_array_equal(goal[mask == 0], achieved[mask == 0])
    expected = 1.0 - np.minimum(np.abs(achieved - goal).sum(axis=-1), 4.0)
    np.testing.assert_allclose(batch.reward.reshape(-1), expected, atol=1e-6)
    assert len(set(expected.round(3))) > 20
    assert batch.reward_range == (-3.0, 1.0)
    # Terminal are the transitions beyond the end, and from there none is drawn.
    np.testing.assert_array_equal(
        batch.continues.reshape(-1), np.where(achieved[:, 0] > END, 0.0, 1.0)
    )
    assert (np.asarray(drawn.observation)[:, 0] <= END).all()
    assert 0 < (batch.continues == 0).sum() < count


def test_rewards_follow_the_rule_of_success_in_hindsight_too() -> None:
    square: Any = checked(Square(), "Square")
    trainer = make_trainer(square, TINY)
    state = trainer.init(tiny())
    drawn = tiny().relabelling.sample(jax.random.key(0), state.replay, 6, 0.1)
    far = jnp.array([[0.29, 0.29], [0.31, 0.0], [0.0, 0.0]] * 2)
    drawn = drawn.replace(next_achieved=far, next_goal=jnp.zeros((6, 2)))
    assert rewards(square, drawn).tolist() == [0.0, -1.0, 0.0] * 2
    with pytest.raises(SettingError, match="relabelling: must fill next_achieved"):
        rewards(square, drawn.replace(next_achieved=None))


def test_targets_do_not_look_beyond_an_end_and_are_clipped_to_the_rewards_own_returns() -> None:
    agent = DDPG(hidden_layers=(8, 8), discount=0.9)
    state, batch = agent.init(jax.random.key(0), SIZES), example_batch()
    reward = jnp.linspace(-3.0, 1.0, 16)
    continues = jnp.arange(16) % 2.0
    numbers = in_numpy(state)
    value = action_value(numbers.critic[0], np.asarray(batch.inputs), np.asarray(batch.action))
    shifted = state.replace(
        target_critic=jax.tree.map(lambda leaf: leaf + 3.0, state.target_critic)
    )
    batch = batch.replace(reward=reward, continues=continues, reward_range=(-3.0, 1.0))
    loss, _ = agent.critic_loss(state.critic, shifted, batch)
    # Huge values of the next state: 1 / (1 - 0.9) is the most that a return can be.
    target = np.where(continues > 0, 10.0, reward)
    assert float(loss) == pytest.approx(np.mean((target - value) ** 2), rel=1e-5)


@pytest.mark.parametrize(
    "values", [{"curriculum": "starts"}, {"curriculum": "goid", "agent": "sac"}]
)
def test_no_type_is_promoted_where_episodes_end(values: dict[str, Any]) -> None:
    trainer = make_trainer(checked(Drifting(), "Drifting"), TINY)
    assert_no_type_is_promoted(trainer, stack([tiny(**values)]))


class Rewarding(Base):
    """Success by the common rule, rewards of its own."""

    reward_range = (-1.0, 0.0)

    def goal_reward(self, achieved_goal: jax.Array, desired_goal: jax.Array) -> jax.Array:
        return -jnp.tanh(jnp.abs(achieved_goal - desired_goal).sum())


@pytest.mark.parametrize(
    ("kind", "why"),
    [(Square, "but env has a rule of success"), (Rewarding, "which env's rewards do not follow")],
)
def test_curricula_that_vary_the_threshold_are_refused(kind: type, why: str) -> None:
    setup = make_setup(checked(kind(), "it"), TINY)
    message = f"^curriculum: accuracy varies the distance threshold, {why}"
    with pytest.raises(SettingError, match=message):
        init_state(setup, tiny(curriculum="accuracy"))


def test_curricula_that_reckon_with_sparse_rewards_are_refused(env: Any) -> None:
    with pytest.raises(SettingError) as refusal:
        init_state(make_setup(env, TINY), tiny(curriculum="mega"))
    assert str(refusal.value) == "curriculum: mega needs rewards of -1 or 0, and env has its own"
    square = make_setup(checked(Square(), "Square"), TINY)  # whose rewards are -1 or 0
    assert init_state(square, tiny(curriculum="mega")).curriculum.cutoff == -3.0


@pytest.mark.parametrize("kind", [Rewarding, Square])
def test_refusals_call_an_own_curriculum_by_its_class(kind: type) -> None:
    class Tightening(Accuracy):
        """Of the user's own."""

    hyper = dataclasses.replace(tiny(), curriculum=Tightening())
    with pytest.raises(
        SettingError, match=r"^curriculum: Tightening varies the distance threshold"
    ):
        init_state(make_setup(checked(kind(), "it"), TINY), hyper)


class Generous(Rewarding):
    """Rewards beyond their range, and of another type."""

    def goal_reward(self, achieved_goal: jax.Array, desired_goal: jax.Array) -> jax.Array:
        return jnp.where(jnp.abs(achieved_goal - desired_goal).sum() < 1.0, 7, -7)


@pytest.mark.parametrize("env", [Generous(), checked(Generous(), "it")], ids=["raw", "checked"])
def test_rewards_are_kept_within_their_range(env: Any) -> None:
    state = make_trainer(env, TINY).init(tiny())
    drawn = tiny().relabelling.sample(jax.random.key(0), state.replay, 2, 0.1)
    drawn = drawn.replace(
        next_achieved=jnp.array([[0.2, 0.2], [3.0, 0.0]]), next_goal=jnp.zeros((2, 2))
    )
    reward = rewards(env, drawn)
    assert reward.tolist() == [0.0, -1.0]
    assert reward.dtype == jnp.float32


def test_rewards_beyond_their_range_are_remarked_on() -> None:
    remarks = remarks_on(checked(Generous(), "it"))
    (remark,) = [line for line in remarks if "where the goal is met exactly" in line]
    line = (
        "goal_reward of it is 7 where the goal is met exactly, beyond its reward_range of -1 to 0"
    )
    assert remark == f"{line}, to which rewards are cut"
    assert remarks_on(checked(Rewarding(), "it")) == []


def test_rewards_without_a_range_are_refused_before_any_training() -> None:
    with pytest.raises(SettingError, match=r"^env: it has goal_reward, so it needs reward_range"):
        make_trainer(NoRange(), TINY).init(tiny())


@settings
class Endless(Future):
    """Says of no state that it is terminal."""

    def sample(self, *arguments: Any, **others: Any) -> Any:
        return super().sample(*arguments, **others).replace(continues=None)


def test_a_way_to_relabel_says_which_states_are_terminal_where_the_environment_ends_episodes(
    env: Any,
) -> None:
    hyper = dataclasses.replace(tiny(), relabelling=Endless())
    state = jax.eval_shape(make_trainer(env, TINY).init, hyper)
    with pytest.raises(SettingError, match=r"^relabelling: must fill continues, since env ends"):
        jax.eval_shape(make_trainer(env, TINY).train, state, hyper, 1)
    square = make_trainer(checked(Square(), "Square"), TINY)  # which ends none
    jax.eval_shape(square.train, jax.eval_shape(square.init, hyper), hyper, 1)


class NoRange(Ruled):
    reward_range = None


class Both(Ruled):
    def goal_success(self, achieved_goal: jax.Array, desired_goal: jax.Array) -> jax.Array:
        return jnp.all(achieved_goal == desired_goal)


class ThreeTolerances(Ruled):
    goal_tolerance = np.ones(3)


class NoTolerance(Ruled):
    goal_tolerance = np.array([0.1, 0.0])


class VectorReward(Ruled):
    def goal_reward(self, achieved_goal: jax.Array, desired_goal: jax.Array) -> jax.Array:
        return achieved_goal - desired_goal


class UnmappedRule(Base):
    """A rule outside of JAX that cannot be vmapped."""

    def goal_success(self, achieved_goal: jax.Array, desired_goal: jax.Array) -> jax.Array:
        shape = jax.ShapeDtypeStruct((), bool)
        return jax.pure_callback(lambda a, b: np.all(a == b), shape, achieved_goal, desired_goal)


class UndefinedAtTheGoal(Ruled):
    def goal_reward(self, achieved_goal: jax.Array, desired_goal: jax.Array) -> jax.Array:
        off = desired_goal - achieved_goal
        return off[0] / jnp.linalg.norm(off)


class UnmappedRestart(Base):
    """Begins anew by way of the host, which cannot be vmapped."""

    def restart(self, state: State) -> State:
        position = state.obs["achieved_goal"]  # pyright: ignore
        return self.state(jax.pure_callback(lambda x: x, position, position), position)


class UnmappedStage(Base):
    stages = (Stage(lambda x: jax.pure_callback(abs, x, x), lambda x, _: x, 2, 0.1),)


REFUSED = {
    UnmappedRestart: "jax.vmap over restart of it fails with NotImplementedError",
    UnmappedStage: "stage 1 of it fails with NotImplementedError",
    NoRange: "has goal_reward, so it needs reward_range",
    Both: "has both goal_tolerance and goal_success",
    ThreeTolerances: r"goal_tolerance of it has shape \(3,\), goals have \(2,\)",
    NoTolerance: "goal_tolerance of it is .*, not one number per dimension",
    VectorReward: r"goal_reward of it returns shape \(2,\), not a scalar",
    UnmappedRule: "goal_success of it fails with NotImplementedError",
    UndefinedAtTheGoal: "goal_reward of it is nan where the goal is met exactly",
}


@pytest.mark.parametrize("kind", REFUSED)
def test_rules_that_cannot_be_are_refused(kind: type) -> None:
    with pytest.raises(SettingError, match=f"^env: .*{REFUSED[kind]}") as refusal:
        checked(kind(), "it")
    assert "\n" not in str(refusal.value)
