"""A Gymnasium goal environment as a `GoalEnvironment`: one callback per step for all rows.

    python -m cgm_jax.train --preset cpu --env gymnasium:panda_gym:PandaReach-v3

JAX sees pure functions. A state carries the seed of its episode and how far it is, and the rows
themselves live in another process (see `rows.py`), so that only states in order can be stepped: an
episode cannot begin in a state that another visited. Seeds come from the loop's keys, and every
rollout begins with a reset, so that a run resumes with the same bits wherever the environment obeys
`reset(seed=...)`.

Success is the environment's own rule: the reward that `compute_reward` gives for an achieved goal,
where it has two values, else `distance_threshold`. Under a mask the rule gets a desired goal that,
in masked dimensions, is the achieved one. Rewards are 0 for success and -1 otherwise. What
terminates ends its episode; what is truncated before its last step is dropped.
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from jax.experimental.buffer_callback import buffer_callback

from cgm_jax.envs.hosted.process import HostedProcess


class HostedState(struct.PyTreeNode):
    """What is known here of an episode.

    Attributes:
        obs: observation, achieved_goal and desired_goal, float32.
        metrics: `physics_warnings`, above 0 for an episode that is to be dropped.
        ended: whether the environment has terminated it, bool scalar.
        seed: of its reset, uint32 scalar.
        ticket: of its rows in the other process, uint32 scalar.
        steps: taken so far, int32 scalar.
    """

    obs: dict[str, jax.Array]
    metrics: dict[str, jax.Array]
    ended: jax.Array
    seed: jax.Array
    ticket: jax.Array
    steps: jax.Array


class HostedTask:
    """See `envs.GoalEnvironment`, and `envs.JudgingEnvironment` for its rules.

    Attributes:
        action_size, episode_length, distance_threshold: see there.
        remarks: lines about what is allowed but hardly meant.
        states_are_whole: whether an episode can go on from a state in a new process; no, so that a
            rollout is never cut.
        is_hosted: whether its episodes are simulated in another process, one simulator each.
        calls_physics: whether its physics is called, outside of XLA.
    """

    states_are_whole = False
    is_hosted = calls_physics = True

    def __init__(self, process: HostedProcess) -> None:
        """The task whose rows live in `process`."""
        facts = process.facts
        self._process = process
        self._sizes = facts["observation_size"], facts["goal_size"]
        self.action_size: int = facts["action_size"]
        self.episode_length: int = facts["episode_length"]
        self.distance_threshold: float = facts["distance_threshold"]
        self.remarks: list[str] = facts["remarks"]

    def reset(self, rng: jax.Array) -> HostedState:
        """Start an episode from a seed that `rng` draws."""
        seed = jax.random.bits(rng, dtype=jnp.uint32) >> 1
        rows = self._rows(self._reset, seed)
        return self._state(rows, seed, jnp.zeros((), jnp.int32))

    def step(self, state: HostedState, action: jax.Array) -> HostedState:
        """Advance by one step with `action` in [-1, 1], scaled to the environment's own range."""
        action = jnp.asarray(action, jnp.float32)
        rows = self._rows(self._step, state.ticket, state.steps, state.seed, action)
        return self._state(rows, state.seed, state.steps + 1)

    def is_terminal(self, state: HostedState) -> jax.Array:
        """Whether the environment has ended the episode."""
        return state.ended

    def goal_success(self, achieved_goal: jax.Array, desired_goal: jax.Array) -> jax.Array:
        """Whether a goal [n] is achieved, by the environment's own rule."""
        shape = jax.ShapeDtypeStruct((), jnp.bool_)
        call = buffer_callback(self._success, shape, vmap_method="broadcast_all")
        return call(achieved_goal, desired_goal)

    def _rows(self, function: Any, *inputs: jax.Array) -> list[jax.Array]:
        observation, goal = self._sizes
        shapes = ((observation, jnp.float32), (goal, jnp.float32), (goal, jnp.float32))
        outputs = [jax.ShapeDtypeStruct((size,), kind) for size, kind in shapes]
        outputs += [jax.ShapeDtypeStruct((), kind) for kind in (jnp.bool_, jnp.bool_, jnp.uint32)]
        return buffer_callback(function, outputs, vmap_method="broadcast_all")(*inputs)

    def _state(self, rows: list[jax.Array], seed: jax.Array, steps: jax.Array) -> HostedState:
        observation, achieved, desired, terminated, truncated, ticket = rows
        return HostedState(
            obs={"observation": observation, "achieved_goal": achieved, "desired_goal": desired},
            metrics={"physics_warnings": truncated.astype(jnp.float32)},
            ended=terminated,
            seed=seed,
            ticket=ticket,
            steps=steps,
        )

    def _reset(self, _: Any, outputs: Any, seed: Any) -> None:
        self._answer("reset", outputs, np.asarray(seed).reshape(-1))

    def _step(self, _: Any, outputs: Any, ticket: Any, steps: Any, seed: Any, action: Any) -> None:
        actions = np.asarray(action).reshape(-1, self.action_size)
        scalars = (np.asarray(value).reshape(-1) for value in (ticket, steps, seed))
        self._answer("step", outputs, *scalars, actions)

    def _success(self, _: Any, outputs: Any, achieved: Any, desired: Any) -> None:
        goals = (np.asarray(goal).reshape(-1, self._sizes[1]) for goal in (achieved, desired))
        self._answer("success", [outputs], *goals)

    def _answer(self, op: str, outputs: Any, *inputs: np.ndarray) -> None:
        for output, values in zip(outputs, self._process.ask(op, *inputs), strict=True):
            buffer = np.asarray(output)
            buffer.reshape(values.shape)[...] = values
