"""From the command to the end of the first training cycle."""

import sys
import tempfile
import time
from statistics import median

from cgm_jax.measuring.child import output_of
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


def measure_starts(repeats: int, *, uncounted: int = 1) -> list[Figure]:
    """From the command to the end of the first training cycle, without and with a cache.

    Args:
        repeats: pairs of starts, of which the medians count.
        uncounted: pairs before these, whose libraries come from the disk.

    Raises:
        MeasurementError: it does not come that far.
    """
    pairs = [_starts() for _ in range(uncounted + repeats)][uncounted:]
    cold, warm = (median(seconds) for seconds in zip(*pairs, strict=True))
    return [
        Figure("start to first training cycle, push, empty cache", cold, "s", high=10),
        Figure("the same, second time", warm, "s", high=10),
    ]


def _starts() -> tuple[float, float]:
    """Seconds of a start with an empty cache, and of one with what that has left there."""
    command = [sys.executable, "-m", "cgm_jax.benchmark", "--part", "first-step"]
    with tempfile.TemporaryDirectory() as cache:

        def start() -> float:
            began = time.time()
            ended = output_of(command, {"JAX_COMPILATION_CACHE_DIR": cache}).split()[-1]
            return float(ended) - began

        return start(), start()
