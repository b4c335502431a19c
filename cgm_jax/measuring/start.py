"""From the command to the end of the first training cycle."""

import os
import subprocess
import sys
import tempfile
import time

from cgm_jax.measuring.figures import Figure
from cgm_jax.measuring.workload import cpu_group


def first_step() -> None:
    """Take one training step, and print when it was done, in seconds since 1970.

    Imports JAX, so that the start includes it.
    """
    import jax

    from cgm_jax.loop.compiler import Compiler
    from cgm_jax.loop.environment import make_environment
    from cgm_jax.loop.training import make_programs, make_trainer

    group = cpu_group("push")
    programs = make_programs(make_trainer(make_environment(group.settings), group.settings))
    hyper = group.hyper()
    with Compiler() as compiler:
        programs = compiler.programs(programs, hyper)
        jax.block_until_ready(programs.train(programs.start(hyper), hyper, 1))
        print(time.time(), flush=True)


def measure_starts() -> list[Figure]:
    """From the command to the end of the first training cycle, without and with a cache."""
    with tempfile.TemporaryDirectory() as cache:
        environment = {**os.environ, "JAX_COMPILATION_CACHE_DIR": cache}
        command = [sys.executable, "-m", "cgm_jax.benchmark", "--part", "first-step"]

        def start() -> float:
            began = time.time()
            ended = subprocess.run(
                command, env=environment, check=True, stdout=subprocess.PIPE, text=True
            )
            return float(ended.stdout.split()[-1]) - began

        cold, warm = start(), start()
    return [
        Figure("start to first training cycle, push, empty cache", cold, "s", high=40),
        Figure("the same, second time", warm, "s", high=15),
    ]
