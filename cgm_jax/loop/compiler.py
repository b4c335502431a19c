"""Programs that are compiled while something else is done.

XLA compiles outside of Python, in C++. So a thread compiles one program while this one traces the
next, and evaluation's is ready when the first epoch is over.
"""

from concurrent.futures import ThreadPoolExecutor
from types import TracebackType
from typing import Any

import jax

from cgm_jax.config.settings import Hyperparameters
from cgm_jax.loop.training import Programs

Program = Any
"""What `jax.jit` returns, which type checkers take for a mere function."""


class Compiler:
    """Compiles in a thread of its own, one program at a time, in the order in which it is asked.

    Leaving its block drops what has not begun and waits for what has: a process that ends while
    XLA compiles may crash.
    """

    def __init__(self) -> None:
        self._worker = ThreadPoolExecutor(1, thread_name_prefix="compiler")
        self._asked: dict[tuple[Program, int], Program] = {}

    def __enter__(self) -> "Compiler":
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._worker.shutdown(cancel_futures=True)

    def programs(
        self, programs: Programs, hyper: Hyperparameters, *, starts: bool = True
    ) -> Programs:
        """Have programs compiled for some runs; they are traced here and now.

        Args:
            programs: to compile.
            hyper: of the runs, every leaf [runs].
            starts: whether states are to be made; those of a checkpoint are there.

        Returns:
            The same programs for so many runs. Each waits, when it is called, until it is
            compiled, and raises what that has raised.
        """
        states = programs.shapes(hyper)
        return programs._replace(
            start=self._compiled(programs.start, hyper) if starts else programs.start,
            train=self._compiled(programs.train, states, hyper, 1),
            evaluate=self._compiled(programs.evaluate, states, hyper),
        )

    def _compiled(self, program: Program, *arguments: Any) -> Program:
        key = program, len(jax.tree.leaves(arguments)[0])
        if key not in self._asked:
            compiling = self._worker.submit(program.lower(*arguments).compile)
            self._asked[key] = lambda *arguments: compiling.result()(*arguments)
        return self._asked[key]
