"""Bits of runs on several devices of a CPU, which a process must be given before JAX starts.

    python -m tests.cgm_jax.loop.on_devices DIRECTORY RUNS:DEVICES[:DEVICES] ...

prints, for each argument, the digests of the runs after two epochs of two cycles, as JSON. After
the first of them they go to a checkpoint, and from it to the second number of devices.
"""

import hashlib
import json
import sys
from pathlib import Path
from typing import Any

import jax
import numpy as np

from cgm_jax.config.fields import stack
from cgm_jax.host.checkpoint import TrainingProgress, load_checkpoint, save_checkpoint
from cgm_jax.host.startup import prepare_jax
from cgm_jax.loop.compiler import Compiler
from cgm_jax.loop.training import Programs, make_programs, make_trainer
from tests.cgm_jax.probe import TINY, tiny
from tests.examples.point_mass import PointMass

TRAINER = make_trainer(PointMass(), TINY)
MADE: dict[int, Programs] = {}


def main() -> None:
    """Train and print."""
    prepare_jax(4)
    directory = Path(sys.argv[1])
    found = []
    for text in sys.argv[2:]:
        runs, first, *others = (int(word) for word in text.split(":"))
        found.append(digests(runs, first, *(others or [first]), directory=directory))
    print(json.dumps(found))


def digests(runs: int, first: int, second: int, *, directory: Path) -> list[str]:
    """Of each run's state and metrics, begun on some devices and resumed on others."""
    hyper = stack([tiny(seed=i, c_g=0.1 + 0.2 * i) for i in range(runs)])
    with Compiler() as compiler:
        programs, later = (
            compiler.programs(programs_on(devices), hyper) for devices in (first, second)
        )
        return _digests(runs, hyper, programs, later, directory)


def _digests(
    runs: int, hyper: Any, programs: Programs, later: Programs, directory: Path
) -> list[str]:
    state, before = programs.evaluate(programs.train(programs.start(hyper), hyper, 2), hyper)
    save_checkpoint(directory, 0, TrainingProgress(state, runs=runs))
    training, _ = load_checkpoint(directory, 0, jax.eval_shape(jax.vmap(TRAINER.init), hyper))
    assert training is not None
    state = later.train(later.spread(training.state), hyper, 2)
    return digests_of((*later.evaluate(state, hyper), before), runs)


def programs_on(devices: int) -> Programs:
    """The programs of so many devices, made once."""
    return MADE.setdefault(devices, make_programs(TRAINER, jax.devices()[:devices]))


def is_key(leaf: jax.Array) -> bool:
    """Whether an array holds typed PRNG keys."""
    return jax.numpy.issubdtype(leaf.dtype, jax.dtypes.prng_key)


def digests_of(tree: Any, runs: int) -> list[str]:
    """Of each of the first rows."""
    leaves = [
        np.asarray(jax.random.key_data(leaf) if is_key(leaf) else leaf)
        for leaf in jax.tree.leaves(tree)
    ]
    rows = (b"".join(leaf[run].tobytes() for leaf in leaves) for run in range(runs))
    return [hashlib.sha256(row).hexdigest() for row in rows]


if __name__ == "__main__":
    main()
