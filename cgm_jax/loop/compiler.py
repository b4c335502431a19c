"""Programs that are compiled while something else is done.

XLA compiles outside of Python, in C++. So a thread compiles one program while this one traces the
next, and evaluation's is compiled while the first epoch trains.
"""

from collections.abc import Callable, Hashable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any

import jax
import numpy as np

from cgm_jax.config.grid import structure
from cgm_jax.config.settings import Hyperparameters
from cgm_jax.loop.training import Programs

Program = Any
"""What `jax.jit` returns, which type checkers take for a mere function."""


def _spread_where_empty(arguments: Any, shardings: Any) -> Any:
    """Arguments whose arrays without elements are spread as a compiled program wants them.

    XLA returns such an array on every device, however it was to be spread, and compiled programs
    refuse it then.
    """
    return jax.tree.map(
        lambda leaf, sharding: leaf if np.size(leaf) else jax.device_put(leaf, sharding),
        arguments,
        shardings,
    )


class Compiling:
    """A program that a thread compiles; a call waits until it is, and raises what that raised."""

    def __init__(self, compiled: Future[Any]) -> None:
        self._compiled = compiled

    def __call__(self, *arguments: Any) -> Any:
        """Run it."""
        compiled = self._compiled.result()
        if not all(map(np.size, jax.tree.leaves(arguments))):
            arguments = _spread_where_empty(arguments, compiled.input_shardings[0])
        return compiled(*arguments)

    def is_done(self) -> bool:
        """Whether a call would not have to wait."""
        return self._compiled.done()

    def wait(self) -> None:
        """Wait without running it."""
        self._compiled.result()


def is_compiling(program: Callable[..., Any]) -> bool:
    """Whether a `Compiler` has not done with a program yet."""
    return isinstance(program, Compiling) and not program.is_done()


def wait_for(program: Callable[..., Any]) -> None:
    """Wait until a program is compiled, if a `Compiler` does that; raise what that raised."""
    if isinstance(program, Compiling):
        program.wait()


class Compiler:
    """Compiles in a thread of its own, one program at a time, in the order in which it is asked.

    Leaving its block drops what has not begun and waits for what has: a process that ends while
    XLA compiles may crash.
    """

    def __init__(self) -> None:
        self._worker = ThreadPoolExecutor(1, thread_name_prefix="compiler")
        self._asked: dict[Hashable, Compiling] = {}

    def __enter__(self) -> "Compiler":
        return self

    def __exit__(self, *_: object) -> None:
        self._worker.shutdown(cancel_futures=True)

    def programs(
        self, programs: Programs, hyper: Hyperparameters, *, starts: bool = True
    ) -> Programs:
        """Have programs compiled for some runs, unless they are already.

        What starts and trains is traced here and now; evaluation's program, which is needed last,
        by the thread once the others are compiled, outside of JAX's context managers that the
        caller may be within.

        Args:
            programs: to compile.
            hyper: of the runs, every leaf [runs].
            starts: whether states are to be made; those of a checkpoint are there.

        Returns:
            The same programs for so many runs of this structure, each of them `Compiling`.
        """
        runs = len(jax.tree.leaves(hyper)[0])
        kind = (runs, structure(programs.trainer.setup.settings, hyper))
        states = programs.shapes(hyper)
        start = self._traced(programs.start, kind, hyper) if starts else programs.start
        return programs._replace(
            start=start,
            train=self._traced(programs.train, kind, states, hyper, 1),
            evaluate=self._traced_later(programs.evaluate, kind, states, hyper),
        )

    def _traced(self, program: Program, kind: Hashable, *arguments: Any) -> Compiling:
        """A program that is traced by the caller."""
        if (program, kind) not in self._asked:
            self._submit((program, kind), program.lower(*arguments).compile)
        return self._asked[program, kind]

    def _traced_later(self, program: Program, kind: Hashable, *arguments: Any) -> Compiling:
        """A program that is traced by the thread."""
        if (program, kind) not in self._asked:
            self._submit((program, kind), lambda: program.lower(*arguments).compile())
        return self._asked[program, kind]

    def _submit(self, key: Hashable, compile_it: Callable[[], Program]) -> None:
        self._asked[key] = Compiling(self._worker.submit(compile_it))
