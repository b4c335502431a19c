"""A random walk on a line, on which the success of every goal and start is known."""

# Brax types the parts of its State as unknown.
# pyright: reportOptionalMemberAccess=false

import functools
import math
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from brax.envs.base import State

from cgm_jax.config.settings import Settings
from cgm_jax.config.sizes import Sizes
from cgm_jax.curricula.protocol import Curriculum, Goals, Outcomes, View
from cgm_jax.loop.state import TrainingState
from cgm_jax.loop.training import Trainer, make_trainer
from tests.cgm_jax.probe import tiny

STEPS = 10
DEVIATION = math.sqrt(STEPS / 3)
"""Of where ten steps lead that are uniform in [-1, 1]."""


@dataclass(frozen=True)
class Line:
    """The action is a step; every episode begins at 0, and goals are uniform between two."""

    lowest_goal: float = -15.0
    highest_goal: float = 15.0
    action_size: int = 1
    episode_length: int = STEPS
    distance_threshold: float = 2.5 * DEVIATION

    def reset(self, rng: jax.Array) -> State:
        goal = jax.random.uniform(rng, (1,), minval=self.lowest_goal, maxval=self.highest_goal)
        return self._state(jnp.zeros(1), goal)

    def restart(self, state: State) -> State:
        return state

    def step(self, state: State, action: jax.Array) -> State:
        return self._state(state.obs["observation"] + action, state.obs["desired_goal"])

    def _state(self, position: jax.Array, goal: jax.Array) -> State:
        obs = {"observation": position, "achieved_goal": position, "desired_goal": goal}
        return State(pipeline_state=None, obs=obs, reward=jnp.zeros(()), done=jnp.zeros(()))


def success_rate(distance: np.ndarray) -> np.ndarray:
    """Chance that a walk ends within the threshold of a goal so far from its start."""
    limits = np.stack([distance + 2.5 * DEVIATION, distance - 2.5 * DEVIATION]) / DEVIATION
    above, below = 0.5 * (1.0 + np.vectorize(math.erf)(limits / math.sqrt(2.0)))
    return above - below


def medium_share(distance: np.ndarray) -> float:
    """Share of distances whose success rate is in [0.1, 0.9]."""
    rates = success_rate(distance)
    return float(((rates >= 0.1) & (rates <= 0.9)).mean())


@functools.cache
def walk(
    curriculum: str, env: Line, cycles: int, updates: int = 4, **values: Any
) -> tuple[Trainer, TrainingState]:
    """Train with random actions, so that success does not depend on what is learned."""
    settings = Settings(
        env="line",
        environments=16,
        updates_per_cycle=updates,
        batch_size=64,
        replay_transitions=16 * STEPS * cycles,
    )
    hyper = tiny(curriculum=curriculum, random_action_probability=1.0, **values)
    trainer = make_trainer(env, settings)
    state = jax.jit(lambda hyper: trainer.train(trainer.init(hyper), hyper, cycles))(hyper)
    return trainer, state


SIZES = Sizes(
    observation=2,
    goal=2,
    action=1,
    inputs=4,
    episode_length=50,
    distance_threshold=0.05,
    environments=4,
    evaluation_episodes=1,
    updates_at_once=1,
    critics=3,
    starts=None,
)


def drawn_goals(desired: Any) -> Goals:
    """What an environment drew, [E, n]."""
    desired = jnp.asarray(desired, jnp.float32)
    return Goals(desired, jnp.ones_like(desired), jnp.full(len(desired), 0.05))


def view(achieved: Any, filled: int, observation: Any, value: Any = None, draw: Any = None) -> View:
    """What a curriculum sees, with these goals in replay [C, T + 1, n]."""
    first = State(None, {"observation": jnp.asarray(observation)}, jnp.zeros(()), jnp.zeros(()))
    return View(first, jnp.asarray(achieved, jnp.float32), jnp.asarray(filled), value, draw)


def compiled_sample(
    curriculum: Curriculum[Any], state: Any, key: jax.Array, drawn: Goals, seen: View
) -> Goals:
    """What a curriculum samples, compiled as in training, which is sooner than step by step."""
    return jax.jit(lambda state, key: curriculum.sample(state, key, drawn, seen))(state, key)


def outcomes(goals: Goals, success: Any, valid: Any = None, visited: Any = None) -> Outcomes:
    """What became of the episodes with these goals."""
    success = jnp.asarray(success, bool)
    return Outcomes(
        goals=goals,
        success=success,
        subgoal_success=jnp.broadcast_to(success[:, None], goals.desired.shape),
        valid=jnp.ones(len(success), bool) if valid is None else jnp.asarray(valid),
        observation=goals.desired,
        visited=visited,
    )


def same_bits(one: Any, other: Any) -> bool:
    """Whether two pytrees of arrays hold the same values, NaN included."""
    pairs = zip(jax.tree.leaves(one), jax.tree.leaves(other), strict=True)
    return all(np.asarray(x).tobytes() == np.asarray(y).tobytes() for x, y in pairs)
