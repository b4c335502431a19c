"""What a way to relabel offers to the loop: minibatches of transitions from the replay ring.

It is a class of settings (see `config/fields.py`) with pure functions of one run, which the loop
maps over runs, the settings included: `sample`, which it must define, and `shows` and
`pursued`, if it needs stages.
"""

from abc import abstractmethod
from collections.abc import Sequence
from typing import TYPE_CHECKING, ClassVar, Protocol, runtime_checkable

import jax
import jax.numpy as jnp
from flax import struct

from cgm_jax.replay.ring import Replay

if TYPE_CHECKING:  # importing environments takes long, and starts JAX
    from cgm_jax.envs import Stage


class Transitions(struct.PyTreeNode):
    """Transitions as the networks see them: goals are masked, rewards recomputed.

    Attributes:
        observation, next_observation: [..., observation_size].
        goal, next_goal: masked with the achieved goal of their own step, [..., n].
        mask: [..., n].
        threshold: the goal is achieved closer than this, [...].
        action: [..., action_size].
        reward: 0 where the next state achieves the masked goal, else -1; [...]. Where the
            environment has a rule of its own the loop puts that in its place.
        next_achieved: the goal achieved in the next state, [..., n].
        continues: 0 where the next state is terminal, else 1; [...]. None where the environment
            ends no episodes (`Episodes.length`).
        subgoal, next_subgoal: of a stage that replaces the goal, [..., `Relabelling.shows`]; None
            for a way to relabel that shows none.
    """

    observation: jax.Array
    goal: jax.Array
    mask: jax.Array
    threshold: jax.Array
    action: jax.Array
    reward: jax.Array
    next_observation: jax.Array
    next_goal: jax.Array
    next_achieved: jax.Array | None = None
    continues: jax.Array | None = None
    subgoal: jax.Array | None = None
    next_subgoal: jax.Array | None = None


@runtime_checkable
class Relabelling(Protocol):
    """A way to draw transitions and to choose their goals.

    Attributes:
        needs_stages: whether the environment must have stages, or is refused.
    """

    needs_stages: ClassVar[bool] = False

    @abstractmethod
    def sample(
        self,
        key: jax.Array,
        replay: Replay,
        count: int,
        distance_threshold: float,
        stages: "Sequence[Stage]" = (),
    ) -> Transitions:
        """Draw transitions.

        Args:
            key: consumed.
            replay: may hold no episode yet; then what is drawn is thrown away.
            count: how many.
            distance_threshold: of the environment.
            stages: of the environment, see `envs.StagedEnvironment`.
        """
        ...

    def shows(self, stages: "Sequence[Stage]") -> int:
        """How many entries of a sub-goal the networks see besides the environment's goal.

        The first of them are one per stage, 1 for the stage that is pursued; all are 0 where it is
        the environment's own goal.
        """
        del stages
        return 0

    def pursued(
        self, stages: "Sequence[Stage]", observation: jax.Array, goal: jax.Array, uniform: jax.Array
    ) -> jax.Array:
        """The sub-goal that exploration pursues now, [E, `shows`]; asked where it `needs_stages`.

        Args:
            stages: of the environment.
            observation: of E episodes, [E, o].
            goal: the environment's own, masked, [E, n].
            uniform: numbers in [0, 1) to decide by, [E].
        """
        del goal, uniform
        return jnp.zeros((observation.shape[0], self.shows(stages)))

    def idle(self) -> frozenset[str]:
        """Names of settings that have no effect, given the others; for concrete values only."""
        return frozenset()


PROTOCOL = Relabelling
