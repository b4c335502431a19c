"""Push on C MuJoCo, with physics that break in about half of the episodes."""

from dataclasses import dataclass, field

import jax
import jax.numpy as jnp
import numpy as np
from brax.envs.base import State

from cgm_jax import envs
from cgm_jax.envs.fetch import FetchEnvironment

# Brax types the parts of its State as unknown.
# pyright: reportAttributeAccessIssue=false, reportOptionalMemberAccess=false

FIRST_JOINT = slice(2, 4)
"""Words of the first joint's position in the state row, behind the time."""


def push() -> FetchEnvironment:
    """The environment proper."""
    return envs.make("push", engine="native")


@dataclass(frozen=True)
class BrokenFetch:
    """Where the block starts on the far half of the table, a joint's position becomes NaN."""

    env: FetchEnvironment = field(default_factory=push)
    action_size: int = 4
    episode_length: int = 50
    distance_threshold: float = 0.05

    def reset(self, rng: jax.Array) -> State:
        """A start that looks healthy and is broken inside, if its block is on the far half."""
        state = self.env.reset(rng)
        row = state.pipeline_state.engine_state
        nan = jnp.asarray(np.array([np.nan]).view(np.uint32))
        broken = state.obs["achieved_goal"][0] > self.env.scene.grip_home[0]
        row = jnp.where(broken, row.at[FIRST_JOINT].set(nan), row)
        return state.replace(pipeline_state=state.pipeline_state.replace(engine_state=row))

    def step(self, state: State, action: jax.Array) -> State:
        """As the environment proper."""
        return self.env.step(state, action)
