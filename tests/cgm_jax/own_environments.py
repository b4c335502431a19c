"""Environments of one's own that made the trainer stumble; each class is one small input."""

# Brax types the parts of its State as unknown.
# pyright: reportAttributeAccessIssue=false, reportOptionalMemberAccess=false
# pyright: reportArgumentType=false, reportIndexIssue=false, reportOptionalSubscript=false
# pyright: reportGeneralTypeIssues=false

import random
import sys
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from brax.envs.base import State


class Base:
    """A point in the plane that moves by its action; healthy."""

    action_size: Any = 2
    episode_length: Any = 25
    distance_threshold: Any = 0.1
    origin = 0.0

    def reset(self, rng: jax.Array) -> State:
        position, goal = jax.random.uniform(rng, (2, 2), minval=-1.0, maxval=1.0)
        return self.state(self.origin + position, self.origin + goal)

    def step(self, state: State, action: jax.Array) -> State:
        moved = state.obs["achieved_goal"] + 0.1 * action
        return self.state(moved, state.obs["desired_goal"])

    def state(self, position: jax.Array, goal: jax.Array) -> State:
        obs = {"observation": position, "achieved_goal": position, "desired_goal": goal}
        return State(None, obs, jnp.zeros(()), jnp.zeros(()))


class NumpyNumbers(Base):
    action_size = np.int64(2)
    episode_length = jnp.int32(25)
    distance_threshold = np.float32(0.125)


class FarInTheFourth(Base):
    """A goal of five dimensions that only the fourth keeps from being achieved."""

    action_size = 5

    def reset(self, rng: jax.Array) -> State:
        return self.state(jnp.zeros(5), jnp.zeros(5).at[3].set(1e3))

    def step(self, state: State, action: jax.Array) -> State:
        return self.state(state.obs["achieved_goal"], state.obs["desired_goal"])


class NeverValid(Base):
    """Every episode is dropped."""

    def state(self, position: jax.Array, goal: jax.Array) -> State:
        return super().state(position * jnp.nan, goal)


class BooleanDone(Base):
    """What nothing reads, differs between reset and step."""

    def step(self, state: State, action: jax.Array) -> State:
        return super().step(state, action).replace(done=jnp.zeros((), bool))


class Careless(Base):
    """Outputs of any shape and type; a counter and a key that it keeps for itself."""

    def reset(self, rng: jax.Array) -> State:
        info = {"rng": rng, "steps": 0.0, "broken": 0}
        return super().reset(rng).replace(info=info, reward=0, done=False)

    def step(self, state: State, action: jax.Array) -> State:
        rng, noise = jax.random.split(state.info["rng"])
        steps = state.info["steps"] + 1
        after = super().step(state, action + 0.0 * jax.random.normal(noise))
        return after.replace(
            reward=-jnp.ones(3),
            done=jnp.zeros((), bool),
            metrics={"distance": jnp.zeros(2), "physics_warnings": jnp.array([False, False])},
            info={"rng": rng, "steps": steps, "extra": 1.0, "broken": steps > 3},
        )


class PlainNumbers(Base):
    """Its numbers are Python's, whose types JAX holds to be weak."""

    def reset(self, rng: jax.Array) -> State:
        return super().reset(rng).replace(pipeline_state={"time": 0.0})

    def step(self, state: State, action: jax.Array) -> State:
        time = state.pipeline_state["time"] + jnp.float32(0.1)
        return super().step(state, action).replace(pipeline_state={"time": time})


class NoMetrics(Base):
    """Its metrics are no dict, which nothing reads."""

    def state(self, position: jax.Array, goal: jax.Array) -> State:
        return super().state(position, goal).replace(metrics=jnp.zeros(3))


class SlowClock(Base):
    """A clock that begins as a whole number would stand still."""

    def reset(self, rng: jax.Array) -> State:
        return super().reset(rng).replace(info={"time": 0})

    def step(self, state: State, action: jax.Array) -> State:
        return super().step(state, action).replace(info={"time": state.info["time"] + 0.1})


class Wrapping(Base):
    """A counter that begins as a small number would begin anew at 256."""

    def reset(self, rng: jax.Array) -> State:
        return super().reset(rng).replace(info={"steps": jnp.uint8(0)})

    def step(self, state: State, action: jax.Array) -> State:
        steps = state.info["steps"].astype(int) + 1
        return super().step(state, action).replace(info={"steps": steps})


class NaNWarning(Base):
    """Its physics break in every step, and say so by NaN."""

    def step(self, state: State, action: jax.Array) -> State:
        return super().step(state, action).replace(metrics={"physics_warnings": jnp.nan})


class ScalarObservation(Base):
    def state(self, position: jax.Array, goal: jax.Array) -> State:
        state = super().state(position, goal)
        return state.replace(obs={**state.obs, "observation": position[0]})


class WholeObservation(Base):
    def state(self, position: jax.Array, goal: jax.Array) -> State:
        state = super().state(position, goal)
        return state.replace(obs={**state.obs, "observation": position.astype(int)})


class ListObservation(Base):
    def state(self, position: jax.Array, goal: jax.Array) -> State:
        state = super().state(position, goal)
        return state.replace(obs={**state.obs, "observation": [1.0, 2.0]})


class NoGoal(Base):
    def state(self, position: jax.Array, goal: jax.Array) -> State:
        return super().state(position[:0], goal[:0])


class OtherObservationAfterStep(Base):
    def step(self, state: State, action: jax.Array) -> State:
        after = super().step(state, action)
        return after.replace(obs={**after.obs, "observation": jnp.zeros(3)})


class OtherPhysicsAfterStep(Base):
    def reset(self, rng: jax.Array) -> State:
        return super().reset(rng).replace(pipeline_state={"q": jnp.zeros(3)})

    def step(self, state: State, action: jax.Array) -> State:
        return super().step(state, action).replace(pipeline_state={"q": jnp.zeros(3, int)})


class OtherMemoryAfterStep(Base):
    def reset(self, rng: jax.Array) -> State:
        return super().reset(rng).replace(info={"past": jnp.zeros(3)})

    def step(self, state: State, action: jax.Array) -> State:
        return super().step(state, action).replace(info={"past": jnp.zeros(4)})


class Drawn(Base):
    """Starts are drawn by a generator of its own, when it is traced."""

    def reset(self, rng: jax.Array) -> State:
        return super().reset(jax.random.fold_in(rng, random.getrandbits(31)))


class DrawnOnTheHost(Base):
    """Its steps are drawn outside JAX."""

    def step(self, state: State, action: jax.Array) -> State:
        def noise(_: np.ndarray) -> np.ndarray:
            return np.random.default_rng().random(2, np.float32)

        shape = jax.ShapeDtypeStruct((2,), np.float32)
        drawn = jax.pure_callback(noise, shape, action, vmap_method="sequential")
        return super().step(state, action + drawn)


class Talkative(Base):
    """Whatever it is asked for that it has not, it says so in its own way."""

    def __getattr__(self, name: str) -> Any:
        raise RuntimeError(f"what is {name}?")


class MovingGoal(Base):
    def step(self, state: State, action: jax.Array) -> State:
        return self.state(state.obs["achieved_goal"] + action, state.obs["desired_goal"] + 1.0)


class FarBeyondFloat32(Base):
    origin = 1e8


class NoState(Base):
    def reset(self, rng: jax.Array) -> Any:
        return None


class StepFails(Base):
    def step(self, state: State, action: jax.Array) -> State:
        return self.state(action + jnp.zeros(3), action)


class BranchesOnValues(Base):
    def step(self, state: State, action: jax.Array) -> State:
        return super().step(state, -action if action[0] > 0 else action)


class ResetExits(Base):
    def reset(self, rng: jax.Array) -> State:
        sys.exit("enough")


class PropertyFails(Base):
    @property
    def episode_length(self) -> int:
        raise RuntimeError("not known\nyet")


class NoMapping(Base):
    """A callback that cannot be vmapped."""

    def step(self, state: State, action: jax.Array) -> State:
        return super().step(state, jax.pure_callback(lambda x: x, action, action))


class NoSteps(Base):
    episode_length = 0


class BooleanSize(Base):
    action_size = True


class FloatLength(Base):
    episode_length = 25.0


class NaNLength(Base):
    episode_length = float("nan")


class HugeSize(Base):
    action_size = 10**30


class MethodLength(Base):
    def episode_length(self) -> int:
        return 25


class NegativeThreshold(Base):
    distance_threshold = -0.1


class NaNThreshold(Base):
    distance_threshold = float("nan")


class InfiniteThreshold(Base):
    distance_threshold = float("inf")


class TextThreshold(Base):
    distance_threshold = "0.1"


class VectorThreshold(Base):
    distance_threshold = np.array([0.1, 0.1])


class TooSmallThreshold(Base):
    """Its square is no number of float32."""

    distance_threshold = 1e-30


def nothing() -> None:
    """A factory that returns nothing."""
