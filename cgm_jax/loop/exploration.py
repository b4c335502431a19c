"""Action noise, drawn for whole rollouts at once.

One draw of all steps compiles and runs faster than a draw per step inside the scan.

Where random actions last for several steps, there are as many of them, but longer stretches
without: long enough to carry something without letting it go.
"""

import jax
import jax.numpy as jnp
from flax import struct
from jaxtyping import Array, Float

from cgm_jax.config.settings import Hyperparameters


class Exploration(struct.PyTreeNode):
    """Noise for actions of any leading shape.

    Attributes:
        perturbation: what is added to an action, [..., action_size].
        random_action: what replaces an action, uniform in [-1, 1], [..., action_size].
        replaced: whether it does, [..., 1] bool.
        key: to explore with, for an agent that does so by itself; a key per step [T], or None.
        uniform: in [0, 1), to choose between a stage and the goal, [...]; None where there are no
            stages to pursue.
    """

    perturbation: jax.Array
    random_action: jax.Array
    replaced: jax.Array
    key: jax.Array | None = None
    uniform: jax.Array | None = None


def draw_exploration(key: jax.Array, shape: tuple[int, ...], hyper: Hyperparameters) -> Exploration:
    """Noise for the actions of whole episodes.

    Gaussian with standard deviation `hyper.action_noise`. Besides, an episode is cut into
    stretches of `hyper.random_action_steps` steps, from a random phase on, so that episodes do not
    keep step; with probability `hyper.random_action_probability` one uniform action replaces all
    of a stretch.

    Args:
        key: consumed.
        shape: of the actions, [T, ..., action_size].
        hyper: hyperparameters of the run.
    """
    normal_key, uniform_key, phase_key = jax.random.split(key, 3)
    steps, *episodes, action_size = shape
    uniform = jax.random.uniform(uniform_key, (steps, *episodes, action_size + 1))
    length = jnp.asarray(hyper.random_action_steps, jnp.float32)
    phase = jnp.floor(length * jax.random.uniform(phase_key, tuple(episodes)))
    step = jnp.arange(steps).reshape(-1, *(1 for _ in episodes))
    stretch = (step + phase.astype(jnp.int32)) // hyper.random_action_steps
    uniform = jnp.take_along_axis(uniform, stretch[..., None], axis=0)
    return Exploration(
        perturbation=hyper.action_noise * jax.random.normal(normal_key, shape),
        random_action=2.0 * uniform[..., 1:] - 1.0,
        replaced=uniform[..., :1] < hyper.random_action_probability,
    )


def explore(
    exploration: Exploration, action: Float[Array, "*batch action"], *, perturb: bool = True
) -> Float[Array, "*batch action"]:
    """The action [..., action_size] with its noise, within [-1, 1].

    Args:
        exploration: the noise.
        action: of the agent.
        perturb: whether to add Gaussian noise; an agent that explores by itself needs none.
    """
    if perturb:
        action = jnp.clip(action + exploration.perturbation, -1.0, 1.0)
    return jnp.where(exploration.replaced, exploration.random_action, action)
