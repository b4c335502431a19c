"""Network updates against a large matrix product."""

import dataclasses
import itertools
from collections.abc import Callable

import jax
import jax.numpy as jnp

from cgm_jax.agents.ddpg import DDPG
from cgm_jax.agents.protocol import Minibatch
from cgm_jax.config.grid import Group
from cgm_jax.config.sizes import Sizes
from cgm_jax.loop.environment import make_environment
from cgm_jax.loop.setup import make_setup
from cgm_jax.loop.setup import sizes as sizes_of
from cgm_jax.measuring.figures import Figure, medians
from cgm_jax.measuring.workload import cpu_group

OBSERVATION, GOAL, ACTIONS = 25, 3, 4
"""Sizes of push and pick-and-place."""

PRODUCT_SIZE = 2048
PRODUCT_OPERATIONS = 2.0 * PRODUCT_SIZE**3
"""Of the product of two square matrices of that size."""


def measure_updates(repeats: int) -> list[Figure]:
    """Floating-point rate of the network updates against that of a large matrix product.

    Of the paper's networks with several batches, and of the cpu preset.
    """
    count, group = 10, cpu_group("push")
    paper = DDPG(target_update_every=1)
    preset = group.runs[0].hyper.agent
    narrow = dataclasses.replace(
        paper,
        hidden_layers=preset.hidden_layers,
        actor_update_every=preset.actor_update_every,
    )
    sizes = Sizes(
        observation=OBSERVATION,
        goal=GOAL,
        action=ACTIONS,
        inputs=OBSERVATION + GOAL,
        episode_length=50,
        distance_threshold=0.05,
        environments=16,
        evaluation_episodes=20,
        updates_at_once=count,
        critics=1,
        starts=None,
    )
    figures, peak = [], 0.0
    of_paper = [(paper, sizes.inputs, batch_size) for batch_size in (256, 512, 1024)]
    of_preset = (narrow, inputs_of(group), group.settings.batch_size)
    for ddpg, width, batch_size in (*of_paper, of_preset):
        agent = ddpg.init(jax.random.key(1), sizes._replace(inputs=width))
        inputs = jax.random.normal(jax.random.key(2), (count, batch_size, width))
        action, reward = jnp.tanh(inputs[..., :ACTIONS]), -jnp.ones(inputs.shape[:2])
        batches = Minibatch(inputs, action, reward, inputs)

        updates = jax.jit(
            lambda agent, batches, ddpg=ddpg: ddpg.train(agent, batches, jax.random.key(3))[0]
        )
        update_seconds, product_seconds = medians(
            [
                lambda agent=agent, batches=batches, updates=updates: jax.block_until_ready(
                    updates(agent, batches)
                ),
                large_product(),
            ],
            repeats,
        )
        rate = count * update_operations(ddpg, batch_size, width) / update_seconds
        peak = PRODUCT_OPERATIONS / product_seconds
        name = f"update, {len(ddpg.hidden_layers)} x {ddpg.hidden_layers[0]}, batch {batch_size}"
        figures += [
            Figure(f"{name} / matrix product", rate / peak, "", low=0.5),
            Figure("  one update", 1e3 * update_seconds / count, "ms"),
        ]
    return [*figures, Figure("  matrix product", peak / 1e9, "GFLOP/s")]


def large_product() -> Callable[[], object]:
    """A call that takes `PRODUCT_OPERATIONS`."""
    matrix = jax.random.normal(jax.random.key(0), (PRODUCT_SIZE, PRODUCT_SIZE))
    product = jax.jit(lambda matrix: matrix @ matrix)
    return lambda: product(matrix).block_until_ready()


def inputs_of(group: Group) -> int:
    """How many numbers the networks of a group's runs see."""
    setup = make_setup(make_environment(group.settings), group.settings)
    return sizes_of(setup, group.runs[0].hyper).inputs


def update_operations(ddpg: DDPG, batch_size: int, inputs: int) -> float:
    """Floating-point operations in the matrix products of one update, on average."""

    def products(input_size: int, output_size: int) -> int:
        widths = [input_size, *ddpg.hidden_layers, output_size]
        return sum(a * b for a, b in itertools.pairwise(widths))

    actor = products(inputs, ACTIONS)
    critic = products(inputs + ACTIONS, 1)
    # Targets: one pass each. Critic loss: forward, and gradients to weights and activations.
    # Actor loss: the same for the actor; the critic forward, and its gradient to the action.
    of_actor = (actor * 3 + critic * 2) / ddpg.actor_update_every
    return 2.0 * batch_size * (actor + critic * (1 + 3) + of_actor)
