"""Programs that are compiled while something else is done.

XLA compiles outside of Python, in C++. So a thread compiles one program while this one traces the
next, and evaluation's is compiled while the first epoch trains.
"""

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from types import TracebackType
from typing import Any

import jax

from cgm_jax.config.settings import Hyperparameters
from cgm_jax.loop.training import Programs

Program = Any
"""What `jax.jit` returns, which type checkers take for a mere function."""


class Compiling:
    """A program that a thread compiles; a call waits until it is, and raises what that raised."""

    def __init__(self, compiled: Future[Any]) -> None:
        self._compiled = compiled

    def __call__(self, *arguments: Any) -> Any:
        """Run it."""
        return self._compiled.result()(*arguments)

    def wait(self) -> None:
        """Wait without running it."""
        self._compiled.result()


def wait_for(program: Callable[..., Any]) -> None:
    """Wait until a program is compiled, if a `Compiler` does that."""
    if isinstance(program, Compiling):
        program.wait()


class Compiler:
    """Compiles in a thread of its own, one program at a time, in the order in which it is asked.

    Leaving its block drops what has not begun and waits for what has: a process that ends while
    XLA compiles may crash.
    """

    def __init__(self) -> None:
        self._worker = ThreadPoolExecutor(1, thread_name_prefix="compiler")
        self._asked: dict[tuple[Program, int], Compiling] = {}

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
        """Have programs compiled for some runs.

        What starts and trains is traced here and now; evaluation's program, which is needed last,
        by the thread, once the others are compiled.

        Args:
            programs: to compile.
            hyper: of the runs, every leaf [runs].
            starts: whether states are to be made; those of a checkpoint are there.

        Returns:
            The same programs for so many runs, each of them `Compiling`.
        """
        states = programs.shapes(hyper)
        return programs._replace(
            start=self._compiled(programs.start, hyper) if starts else programs.start,
            train=self._compiled(programs.train, states, hyper, 1),
            evaluate=self._compiled(programs.evaluate, states, hyper, later=True),
        )

    def _compiled(self, program: Program, *arguments: Any, later: bool = False) -> Compiling:
        key = program, len(jax.tree.leaves(arguments)[0])
        if key not in self._asked:
            if later:
                compiled = self._worker.submit(_trace_and_compile, program, *arguments)
            else:
                compiled = self._worker.submit(program.lower(*arguments).compile)
            self._asked[key] = Compiling(compiled)
        return self._asked[key]


def _trace_and_compile(program: Program, *arguments: Any) -> Program:
    return program.lower(*arguments).compile()
