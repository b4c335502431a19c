"""What the networks see: normalised observation and goal, and what else tells goals apart.

A masked dimension and one that happens to be achieved look alike. With `mask_input` the networks
also see which dimensions are masked (1 = masked); with a curriculum that varies the threshold, its
logarithm over the environment's own. With a way to relabel that has exploration pursue stages on
the way to the goal they see the stage, and then nothing of the goal. All of that is 0 for the
environment's own goal, whole, so that an exported policy, which serves that, needs none of it.
"""

import jax.numpy as jnp
from jaxtyping import Array, Float

from cgm_jax.config.settings import Hyperparameters
from cgm_jax.loop.normaliser import Normaliser, network_input
from cgm_jax.loop.setup import Setup


def network_inputs(
    setup: Setup,
    hyper: Hyperparameters,
    normaliser: Normaliser,
    observation: Float[Array, "*batch o"],
    goal: Float[Array, "*batch n"],
    mask: Float[Array, "*batch n"],
    threshold: Float[Array, "*batch"],
    subgoal: Float[Array, "*batch shown"] | None = None,
) -> Float[Array, "*batch inputs"]:
    """Inputs [..., sizes.inputs] for observations [..., o] and masked goals [..., n].

    Args:
        setup: says what is shown.
        hyper: of the run.
        normaliser: of the run.
        observation: [..., o].
        goal: masked, [..., n].
        mask: [..., n].
        threshold: [...].
        subgoal: of a stage that replaces the goal, [..., `Relabelling.shows`]; None for the goal.
    """
    parts = [network_input(normaliser, observation, goal)]
    if setup.settings.mask_input:
        parts.append(1.0 - mask)
    if hyper.curriculum.shows_threshold:
        parts.append(jnp.log(threshold / setup.env.distance_threshold)[..., None])
    if shown := hyper.relabelling.shows(setup.stages):
        if subgoal is None:
            subgoal = jnp.zeros((*observation.shape[:-1], shown))
        seen = observation.shape[-1]
        own = 1.0 - subgoal[..., : len(setup.stages)].sum(axis=-1, keepdims=True)
        about_goal = [parts[0][..., seen:], *parts[1:]]
        parts = [parts[0][..., :seen], *(own * part for part in about_goal), subgoal]
    return jnp.concatenate(parts, axis=-1) if len(parts) > 1 else parts[0]
