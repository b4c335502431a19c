"""The Fetch environments: an arm over a table, a box, and a goal position."""

import math
import numbers
from collections.abc import Mapping
from dataclasses import dataclass

import jax
import jax.numpy as jnp

from cgm_jax.envs.goal_environment import Stage
from cgm_jax.envs.goals import is_achieved
from cgm_jax.envs.mocap_controller import Gripper, control_target
from cgm_jax.envs.observations import GRIP_POSITION, OBJECT_POSITION, fetch_observation
from cgm_jax.envs.physics.protocol import Physics, PhysicsState
from cgm_jax.envs.quiet_import import Env, State
from cgm_jax.envs.scene import Scene
from cgm_jax.envs.tasks import STEPS_PER_EPISODE, Task

OFFSET_RANGE = 0.15
"""Object and goal lie within this of the initial grip position, in x and in y (m)."""

MIN_OBJECT_DISTANCE = 0.1
"""Horizontal distance of the object from the initial grip position, at least (m)."""

MAX_GOAL_HEIGHT = 0.45
"""A goal in the air lies up to this above the object's resting height (m)."""

CLEARANCE = 0.1
"""A grip so far above the object passes over it (m)."""

DESCENT = 2.0
"""Metres that the grip comes down for each metre that it approaches the place where it is to be."""


FIELDS = {
    "air_probability": numbers.Real,
    "distance_threshold": numbers.Real,
    "episode_length": numbers.Integral,
}
"""Settings of an environment, and what kind of number each is."""


@dataclass(frozen=True, eq=False)  # by identity, as brax's are, which are hashed
class FetchEnvironment(Env):
    """One Fetch task on one physics engine; a brax environment and a `GoalEnvironment`.

    Observation, action, reset and reward rules are those of Gymnasium-Robotics' Fetch, but for an
    age of 2 ms of what is observed there; see `fetch_observation`.

    Attributes:
        task: which task.
        scene: its model.
        physics: the engine.
        air_probability: chance that a goal lies above the table, up to 0.45 m (with an object).
        distance_threshold: a goal is achieved closer than this, metres.
        episode_length: control steps (of 0.04 s) per episode.

    Raises:
        TypeError: a field is no number of its kind.
        ValueError: a field out of its range.
    """

    task: Task
    scene: Scene
    physics: Physics
    air_probability: float
    distance_threshold: float = 0.05
    episode_length: int = STEPS_PER_EPISODE

    def __post_init__(self) -> None:
        for name, kind in FIELDS.items():
            value = getattr(self, name)
            if not isinstance(value, kind) or isinstance(value, bool):
                number = "number" if kind is numbers.Real else "whole number"
                raise TypeError(f"{name}: {value!r} is no {number}")
        if not 0.0 <= self.air_probability <= 1.0:
            raise ValueError(f"air_probability: {self.air_probability} is not within [0, 1]")
        if not 0.0 < self.distance_threshold < math.inf:
            raise ValueError(
                f"distance_threshold: {self.distance_threshold} is not above 0 and finite"
            )
        if self.episode_length < 1:
            raise ValueError(f"episode_length: {self.episode_length} is not at least 1")

    @property
    def observation_size(self) -> dict[str, int]:
        """Size of each entry of `State.obs`."""
        size = 25 if self.task.has_object else 10
        return {"observation": size, "achieved_goal": 3, "desired_goal": 3}

    @property
    def action_size(self) -> int:
        """Grip displacement (x, y, z) and the finger command."""
        return 4

    @property
    def backend(self) -> str:
        """Name of the engine's class."""
        return type(self.physics).__name__

    @property
    def compiles_physics(self) -> bool:
        """Whether XLA compiles the engine."""
        return self.physics.is_compiled

    @property
    def calls_physics(self) -> bool:
        """Whether the engine is called, outside of XLA."""
        return not self.physics.is_compiled

    @property
    def compiler_options(self) -> Mapping[str, bool]:
        """XLA's options for programs that have the engine in them, as `jax.jit` takes them."""
        return self.physics.compiler_options

    @property
    def stages(self) -> tuple[Stage, ...]:
        """With an object: the grip where it can move the object towards the goal."""
        if not self.task.has_object:
            return ()
        return (Stage(_grip_position, self._approach, 3, self.task.approach_within),)

    def reset(self, rng: jax.Array) -> State:
        """Start an episode: a new object position and a new goal, drawn from `rng`."""
        object_key, goal_key = jax.random.split(rng)
        return self.reset_to(self.sample_object(object_key), self.sample_goal(goal_key))

    def reset_to(self, object_xy: jax.Array, desired_goal: jax.Array) -> State:
        """Start an episode with the object at `object_xy` [2] and this goal [3], in metres.

        Without an object `object_xy` has no effect.

        Raises:
            ValueError: another shape.
        """
        _check_shape("object_xy", object_xy, 2)
        _check_shape("desired_goal", desired_goal, 3)
        positions = jnp.asarray(self.scene.home, jnp.float32)
        if self.scene.object_address is not None:
            here = slice(self.scene.object_address, self.scene.object_address + 2)
            positions = positions.at[here].set(object_xy)
        return self._state(self.physics.start(positions), jnp.asarray(desired_goal, jnp.float32))

    def restart(self, state: State) -> State:
        """Begin an episode in a state that an earlier one visited, with its goal."""
        physics_state: PhysicsState = state.pipeline_state  # pyright: ignore[reportAssignmentType]
        anew = physics_state.replace(warnings=jnp.zeros_like(physics_state.warnings))
        return self._state(anew, state.obs["desired_goal"])

    def step(self, state: State, action: jax.Array) -> State:
        """Advance by one control step of 0.04 s with `action` [4] in [-1, 1].

        Raises:
            ValueError: an action of another shape.
        """
        _check_shape("action", action, self.action_size)
        physics_state: PhysicsState = state.pipeline_state  # pyright: ignore[reportAssignmentType]
        gripper = self._gripper(physics_state)
        target = control_target(action, gripper, pose_lag=self.task.pose_lag)
        advanced = self.physics.advance(physics_state, target)
        # What wrappers of brax keep in `info` goes along.
        return self._state(advanced, state.obs["desired_goal"]).replace(info=state.info)  # pyright: ignore

    def sample_object(self, key: jax.Array) -> jax.Array:
        """A position [2] uniform in the square around the grip, less the disc below the grip.

        By rejection of a fixed number of draws, so that the function stays free of loops: the
        disc takes 35 % of the square, so that all 32 are rejected once in 4e14 resets; such a
        reset gets the last draw.
        """
        draws = jax.random.uniform(key, (32, 2), minval=-OFFSET_RANGE, maxval=OFFSET_RANGE)
        accepted = jnp.linalg.norm(draws, axis=-1) >= MIN_OBJECT_DISTANCE
        first = jnp.where(accepted.any(), jnp.argmax(accepted), len(draws) - 1)
        return jnp.asarray(self.scene.grip_home[:2], jnp.float32) + draws[first]

    def sample_goal(self, key: jax.Array) -> jax.Array:
        """A goal [3]: around the initial grip position, or on or above the table for the object."""
        x, y, z, air, height = jax.random.uniform(key, (5,))
        offset = OFFSET_RANGE * (2.0 * jnp.stack([x, y, z]) - 1.0)
        goal = jnp.asarray(self.scene.grip_home, jnp.float32) + offset
        if self.scene.object_home is None:
            return goal
        height = jnp.where(air < self.air_probability, MAX_GOAL_HEIGHT * height, 0.0)
        return goal.at[2].set(self.scene.object_home[2] + height)

    def _approach(self, observation: jax.Array, goal: jax.Array) -> jax.Array:
        """Where the grip is to be before it moves the object, [3] in metres.

        Behind the object, seen from the goal, and above that place as long as the grip is beside
        it, so that on the way there the grip passes over the object.
        """
        place = observation[OBJECT_POSITION]
        way = goal - place
        # Shorter next to the goal, where the way has no direction.
        step = way / jnp.maximum(jnp.linalg.norm(way), self.distance_threshold)
        behind = place - self.task.approach * step
        beside = jnp.linalg.norm((observation[GRIP_POSITION] - behind)[:2])
        height = DESCENT * jnp.maximum(beside - 0.5 * self.task.approach_within, 0.0)
        return behind.at[2].add(jnp.minimum(height, CLEARANCE))

    def _state(self, physics_state: PhysicsState, desired_goal: jax.Array) -> State:
        sensor = "object_position" if self.task.has_object else "grip_position"
        achieved_goal = self._reading(physics_state, sensor)
        whole = jnp.ones_like(desired_goal)
        achieved = is_achieved(desired_goal, whole, achieved_goal, self.distance_threshold)
        return State(
            pipeline_state=physics_state,  # pyright: ignore[reportArgumentType]
            obs={
                "observation": fetch_observation(
                    lambda sensor: self._reading(physics_state, sensor),
                    has_object=self.task.has_object,
                    fingers_blocked=self.task.fingers_blocked,
                ),
                "achieved_goal": achieved_goal,
                "desired_goal": desired_goal,
            },
            reward=jnp.where(achieved, 0.0, -1.0),
            done=jnp.zeros(()),  # episodes end by length alone
            metrics={
                "success": achieved.astype(jnp.float32),
                "physics_warnings": physics_state.warnings.astype(jnp.float32),
            },
        )

    def _gripper(self, physics_state: PhysicsState) -> Gripper:
        right, left = (
            self._reading(physics_state, f"{side}_finger_position") for side in ("right", "left")
        )
        return Gripper(
            position=self._reading(physics_state, "gripper_position"),
            orientation=self._reading(physics_state, "gripper_orientation"),
            velocity=self._reading(physics_state, "grip_velocity"),
            finger_positions=jnp.concatenate([right, left]),
        )

    def _reading(self, physics_state: PhysicsState, sensor: str) -> jax.Array:
        return physics_state.sensors[self.scene.sensors[sensor]]


def _grip_position(observation: jax.Array) -> jax.Array:
    return observation[GRIP_POSITION]


def _check_shape(name: str, array: jax.Array, size: int) -> None:
    # JAX clamps an index that is out of range, so that three entries would pass for four.
    if jnp.shape(array) != (size,):
        raise ValueError(f"{name}: shape {jnp.shape(array)} is not {(size,)}")
