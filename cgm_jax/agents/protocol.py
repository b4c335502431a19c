"""What an agent offers to the loop.

An agent is a class of settings (see `config/fields.py`) with pure functions over a state of its
own, any flax struct of arrays. All are written for one run; the loop maps them over runs, the
settings included. A new agent is one new file with one class derived from `Agent`. It must define
`critics`, `init`, `act`, `train` and `actor`, and `value` if it has critics.

The state keeps its structure, shapes and types. A run whose state is not finite, or holds a number
beyond 1e9, is frozen and named by the field; fields whose names end in "optimiser" may hold more.

Rewards are -1 or 0 and no state is terminal, so that returns lie in [-1 / (1 - gamma), 0], unless
an environment has rewards of its own (`Minibatch.reward_range`) or ends episodes (`continues`).
"""

from abc import abstractmethod
from typing import Any, ClassVar, Protocol, TypeVar, runtime_checkable

import jax
import jax.numpy as jnp
from flax import struct
from jaxtyping import Array, Float

from cgm_jax.config.fields import SettingError
from cgm_jax.config.sizes import Sizes

State = TypeVar("State")
Parameters = Any
Info = dict[str, jax.Array]


class Minibatch(struct.PyTreeNode):
    """Transitions with goals and observations as the networks take them.

    Attributes:
        inputs, next_inputs: [..., inputs].
        action: [..., action].
        reward: 0 where the next state achieves the goal, else -1, or the environment's; [...].
        continues: 0 where the next state is terminal, else 1; [...]; None where none ever is.
        reward_range: least and greatest reward.
    """

    inputs: jax.Array
    action: jax.Array
    reward: jax.Array
    next_inputs: jax.Array
    continues: jax.Array | None = None
    reward_range: tuple[float, float] = struct.field(pytree_node=False, default=(-1.0, 0.0))

    def discounts(self, discount: float | jax.Array) -> jax.Array:
        """What the next state counts for [...]: gamma, and nothing once the episode ends."""
        return jnp.asarray(discount if self.continues is None else discount * self.continues)


@runtime_checkable
class Agent(Protocol[State]):
    """Pure functions of one run over a state; derive from it.

    Attributes:
        explores: whether `act` with a key explores by itself; else the loop adds Gaussian noise.
            Uniform random actions are the loop's for all agents.
        logged: names of the scalars that `train` returns, all of which it must return.
    """

    explores: ClassVar[bool] = False
    logged: ClassVar[tuple[str, ...]] = ("critic_loss", "actor_loss", "value")

    critics: int
    """How many estimates of the return `value` gives: a setting, or a number of the class."""

    @abstractmethod
    def init(self, key: jax.Array, sizes: Sizes) -> State:
        """Fresh networks.

        Raises:
            SettingError: settings that do not go with the loop's, such as a number of updates at
                once that `train` does not take.
        """
        ...

    @abstractmethod
    def act(
        self, state: State, inputs: Float[Array, "*batch inputs"], key: jax.Array | None = None
    ) -> Float[Array, "*batch action"]:
        """Actions [..., action] in [-1, 1] for training, from normalised inputs [..., inputs].

        Args:
            state: of the agent.
            inputs: what the networks see.
            key: to explore with, for an agent that `explores`.
        """
        ...

    def value(
        self,
        state: State,
        inputs: Float[Array, "*batch inputs"],
        action: Float[Array, "*batch action"],
    ) -> Float[Array, " critics *batch"]:
        """What each critic expects of an action, [critics, ...]; here of none."""
        del state, action
        return jnp.zeros((0, *inputs.shape[:-1]))

    @abstractmethod
    def train(self, state: State, batches: Minibatch, key: jax.Array) -> tuple[State, Info]:
        """Learn from the minibatches of a cycle, or of a part of it, [updates, batch, ...].

        Returns:
            The state, and scalars to log: arrays [k], all of one length, of which the loop takes
            the mean.
        """
        ...

    @abstractmethod
    def actor(self, state: State) -> Parameters:
        """The deterministic policy that is evaluated and exported, instead of `act`.

        A perceptron as `networks.Actor` has it: ReLU between layers, tanh at the end, parameters
        {"params": {"layer_0": {"kernel": [in, out], "bias": [out]}, ...}}.
        """
        ...

    def with_actor(self, state: State, actor: Parameters) -> State:
        """The state with another policy, `actor`'s inverse: what `--from policy.npz` needs.

        Raises:
            SettingError: the agent does not offer it.
        """
        del state, actor
        raise SettingError("from: the agent does not take a policy over; name a run directory")

    def idle(self) -> frozenset[str]:
        """Names of settings that have no effect, given the others; for concrete values only."""
        return frozenset()


PROTOCOL = Agent
