"""Sweeps in this process that share what they compile."""

import contextlib
import dataclasses
import functools
from collections.abc import Iterator
from typing import Any
from unittest import mock

from cgm_jax.host import jobs
from cgm_jax.loop.compiler import Compiler
from cgm_jax.loop.training import Programs, Trainer, make_programs, make_trainer


class SharedPrograms:
    """Programs by environment and settings, each compiled once, on one device."""

    def __init__(self) -> None:
        self.compiler = Compiler()
        self._trainer = functools.cache(make_trainer)
        self._programs: dict[Any, Programs] = {}

    @contextlib.contextmanager
    def used(self) -> Iterator[None]:
        """Have sweeps in the block take them."""
        mine = contextlib.nullcontext(self.compiler)
        with (
            mock.patch.object(jobs, "make_trainer", self._trainer),
            mock.patch.object(jobs, "make_programs", self._made),
            mock.patch("cgm_jax.loop.compiler.Compiler", return_value=mine),
        ):
            yield

    def close(self) -> None:
        """Wait for what still compiles."""
        with self.compiler:
            pass

    def _made(self, trainer: Trainer, _: object) -> Programs:
        host_only = {"epochs": 1, "leave_at": None}  # what only the host looks at
        key = trainer.setup.env, dataclasses.replace(trainer.setup.settings, **host_only)
        if key not in self._programs:
            self._programs[key] = make_programs(trainer)
        return self._programs[key]  # of another trainer the host reads nothing that differs


@contextlib.contextmanager
def shared_programs() -> Iterator[None]:
    """Have sweeps in the block share programs with each other."""
    with contextlib.closing(SharedPrograms()) as shared, shared.used():
        yield
