"""What the tests of agents share: networks in numpy, and a minibatch of no environment."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from cgm_jax.agents.protocol import Info, Minibatch
from cgm_jax.config.sizes import Sizes

SHAPES = {"inputs": (3,), "action": (2,), "reward": (), "next_inputs": (3,)}
"""Of one transition of the example."""

SIZES = Sizes(
    observation=2,
    goal=1,
    action=2,
    inputs=3,
    episode_length=5,
    distance_threshold=0.1,
    environments=1,
    evaluation_episodes=1,
    updates_at_once=12,
    critics=1,
    starts=None,
)
"""Of the task that the example stands for."""


def example_batch(*leading: int, seed: int = 0) -> Minibatch:
    """Transitions with leading axes, [*leading, 16, ...]."""
    generator = np.random.default_rng(seed)

    def drawn(name: str) -> jax.Array:
        shape = (*leading, 16, *SHAPES[name])
        if name == "reward":
            return jnp.asarray(-generator.integers(0, 2, shape), jnp.float32)
        if name == "action":
            return jnp.asarray(generator.uniform(-1, 1, shape), jnp.float32)
        return jnp.asarray(generator.normal(size=shape), jnp.float32)

    arrays: dict[str, Any] = {name: drawn(name) for name in SHAPES}
    return Minibatch(**arrays)


@jax.jit
def update(agent: Any, state: Any, batch: Minibatch) -> tuple[Any, Info]:
    """`agent.update`, compiled as a whole."""
    return agent.update(state, batch)


@jax.jit
def update_critic(agent: Any, state: Any, batch: Minibatch) -> tuple[Any, Info]:
    """`agent.update_critic`, compiled as a whole."""
    return agent.update_critic(state, batch)


@jax.jit
def train(agent: Any, state: Any, batches: Minibatch, key: jax.Array) -> tuple[Any, Info]:
    """`agent.train`, compiled as a whole."""
    return agent.train(state, batches, key)


def perceptron(parameters: Any, inputs: np.ndarray) -> np.ndarray:
    """The last layer's outputs, before any squashing."""
    layers = parameters["params"]
    *hidden, last = (layers[f"layer_{i}"] for i in range(len(layers)))
    for layer in hidden:
        inputs = np.maximum(inputs @ layer["kernel"] + layer["bias"], 0.0)
    return inputs @ last["kernel"] + last["bias"]


def action_value(critic: Any, inputs: np.ndarray, action: np.ndarray) -> np.ndarray:
    """A critic's estimate, [batch]."""
    return perceptron(critic, np.concatenate([inputs, action], -1))[:, 0]


def in_numpy(tree: Any) -> Any:
    """A pytree with float64 arrays for leaves."""
    return jax.tree.map(lambda leaf: np.asarray(leaf, np.float64), tree)


def assert_close(one: Any, other: Any) -> None:
    """Two pytrees agree but for the rounding of float32."""
    for x, y in zip(jax.tree.leaves(one), jax.tree.leaves(other), strict=True):
        np.testing.assert_allclose(x, y, rtol=1e-4, atol=1e-6)


def assert_equal(one: Any, other: Any) -> None:
    """Two pytrees agree to the last bit."""
    for x, y in zip(jax.tree.leaves(one), jax.tree.leaves(other), strict=True):
        np.testing.assert_array_equal(x, y)
