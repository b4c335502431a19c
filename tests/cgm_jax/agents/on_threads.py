"""Bits of updates in a process with so many threads, which JAX is given before it starts.

    PJRT_NPROC=8 python -m tests.cgm_jax.agents.on_threads

prints the digest of each agent's state after two updates, for several widths and batches, as JSON.
"""

import hashlib
import itertools
import json

import jax
import jax.numpy as jnp
import numpy as np

from cgm_jax.agents.protocol import Minibatch
from cgm_jax.config.components import component
from cgm_jax.host.startup import prepare_jax
from tests.cgm_jax.agents import oracle
from tests.cgm_jax.agents.trained import AGENTS, bits

WIDTHS, BATCHES = (64, 128, 256), (200, 512)
SIZES = oracle.SIZES._replace(inputs=28, action=4)


def main() -> None:
    """Update and print."""
    prepare_jax()
    jax.config.update("jax_enable_compilation_cache", False)  # its programs' bits would do
    cases = [*itertools.product(AGENTS, WIDTHS, BATCHES), ("ddpg", 256, 4096)]
    print(json.dumps({f"{case}": digest(*case) for case in cases}))


def digest(agent: str, width: int, batch_size: int) -> str:
    """Of an agent's state after two updates from random minibatches."""
    learner = component("agent", agent)(hidden_layers=(width, width))
    keys = jax.random.split(jax.random.key(0), 6)
    rows = (SIZES.updates_at_once, batch_size)
    batches = Minibatch(
        inputs=jax.random.normal(keys[0], (*rows, SIZES.inputs)),
        action=jax.random.uniform(keys[1], (*rows, SIZES.action), minval=-1.0),
        reward=-jax.random.bernoulli(keys[2], shape=rows).astype(jnp.float32),
        next_inputs=jax.random.normal(keys[3], (*rows, SIZES.inputs)),
    )
    state, _ = jax.jit(learner.train)(learner.init(keys[4], SIZES), batches, keys[5])
    return hashlib.sha256(b"".join(np.asarray(leaf).tobytes() for leaf in bits(state))).hexdigest()


if __name__ == "__main__":
    main()
