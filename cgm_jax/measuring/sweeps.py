"""Runs side by side against as many runs alone."""

import dataclasses
from collections.abc import Callable, Sequence

import jax

from cgm_jax.config.fields import stack
from cgm_jax.config.grid import Run
from cgm_jax.loop.environment import make_environment
from cgm_jax.loop.training import make_programs, make_trainer
from cgm_jax.measuring.compilations import programs_compiled
from cgm_jax.measuring.figures import Figure, medians
from cgm_jax.measuring.workload import cpu_group


def measure_sweep(repeats: int) -> list[Figure]:
    """A sweep of 6 against 6 single runs, and what compiles after the first epoch."""
    group = cpu_group("push", runs=6)
    settings = dataclasses.replace(group.settings, cycles_per_epoch=2)
    programs = make_programs(make_trainer(make_environment(settings), settings))

    def trainer_of(runs: Sequence[Run]) -> Callable[[], None]:
        hyper = stack([run.hyper for run in runs])
        states = [programs.start(hyper)]

        def epoch() -> None:
            state = programs.train(states.pop(), hyper, settings.cycles_per_epoch)
            state, _ = programs.evaluate(state, hyper)
            states.append(jax.block_until_ready(state))

        return epoch

    six, one = trainer_of(group.runs), trainer_of(group.runs[:1])
    for epoch in (six, one):
        epoch()
    before = programs_compiled()
    six_seconds, one_seconds = medians([six, one], repeats)
    later = programs_compiled() - before
    return [
        Figure(
            "sweep of 6 / 6 single runs, push, time", six_seconds / (6 * one_seconds), "", high=1.15
        ),
        Figure("compilations after the first epoch", later, "", high=0),
    ]
