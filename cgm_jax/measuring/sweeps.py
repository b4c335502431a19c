"""Runs of a sweep against as many runs alone."""

import dataclasses
from collections.abc import Callable

import jax

from cgm_jax.config.grid import Group
from cgm_jax.host.to_train import plan
from cgm_jax.measuring.compilations import programs_compiled
from cgm_jax.measuring.figures import Figure, medians
from cgm_jax.measuring.workload import cpu_group

RUNS = 6


def measure_sweep(repeats: int) -> list[Figure]:
    """A sweep of 6 against 6 single runs, and what compiles after the first epoch.

    As `cgm_jax.sweep` trains them: a core each, where there are as many, and the single run on all.
    """
    sweep, one = _epoch_of(cpu_group("push", RUNS)), _epoch_of(cpu_group("push"))
    for epoch in (sweep, one):
        epoch()
    before = programs_compiled()
    sweep_seconds, one_seconds = medians([sweep, one], repeats)
    later = programs_compiled() - before
    ratio = sweep_seconds / (RUNS * one_seconds)
    return [
        Figure(f"sweep of {RUNS} / {RUNS} single runs, push, time", ratio, "", high=1.15),
        Figure("compilations after the first epoch", later, "", high=0),
    ]


def _epoch_of(group: Group) -> Callable[[], None]:
    """A short epoch of a group's runs, planned as a sweep plans it."""
    settings = dataclasses.replace(group.settings, cycles_per_epoch=2)
    ((job,), _) = plan([dataclasses.replace(group, settings=settings)], None, planned=True)
    hyper, programs = job.group.hyper(), job.programs
    states = [programs.start(hyper)]

    def epoch() -> None:
        state = programs.train(states.pop(), hyper, settings.cycles_per_epoch)
        state, _ = programs.evaluate(state, hyper)
        states.append(jax.block_until_ready(state))

    return epoch
