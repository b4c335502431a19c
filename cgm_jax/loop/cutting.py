"""Which cycles are so long that they are cut into parts, and where (`parts.py` takes them so).

A signal ends training with a checkpoint within seconds, and a compiled program cannot be cut short.
So where a cycle may take longer, training can be stopped in the middle of one.

Whether cycles are cut depends on the settings and the platform, never on how long something took.
So a run's cycles are all cut or all whole, and its bits stay the same however often it is stopped.
A GPU's cycles are never cut.
"""

from collections.abc import Callable
from typing import NamedTuple

from cgm_jax.config.fields import SettingError
from cgm_jax.config.settings import Settings
from cgm_jax.envs import GoalEnvironment
from cgm_jax.loop.environment import compiles_physics

WHOLE_STEPS = 25_600
"""Environment steps of the largest cycle that is whole: about a second on a core."""

COMPILED_PHYSICS = 32
"""How many of them a step counts for on a CPU where XLA compiles the physics, as MJX's."""

WHOLE_TRANSITIONS = 2**17
"""Transitions that the updates of such a cycle learn from; with usual networks a second or two."""

PART_TRANSITIONS = 2**15
"""Transitions that a part of a cycle learns from, at most."""


class Parts(NamedTuple):
    """How a cycle is cut.

    Attributes:
        rollout: parts of its rollout, each of as many steps.
        updates: parts of its updates, each of as many updates.
    """

    rollout: int
    updates: int

    @property
    def total(self) -> int:
        """Parts of a cycle."""
        return self.rollout + self.updates


WHOLE = Parts(rollout=1, updates=0)
"""A cycle that is not cut is one part, whose updates follow on its rollout."""


def is_cut(env: GoalEnvironment, settings: Settings, platform: str) -> bool:
    """Whether cycles are cut.

    Args:
        env: what to train on.
        settings: of the loop.
        platform: what the programs are for, as JAX names it.
    """
    steps = settings.environments * env.episode_length
    steps *= COMPILED_PHYSICS if compiles_physics(env) else 1
    transitions = settings.updates_per_cycle * settings.batch_size
    return platform == "cpu" and (steps > WHOLE_STEPS or transitions > WHOLE_TRANSITIONS)


def updates_at_once(settings: Settings, check: Callable[[int], object]) -> int:
    """How many updates a part holds where cycles are cut.

    Args:
        settings: of the loop.
        check: raises SettingError for a number of minibatches that the agent does not take.

    Returns:
        Of the divisors of `updates_per_cycle` that suit the agent the largest that makes parts
        short enough, else the smallest; all updates if none suits it.
    """
    whole = settings.updates_per_cycle
    divisors = [whole // parts for parts in range(1, whole + 1) if whole % parts == 0]
    short = [count for count in divisors if count * settings.batch_size <= PART_TRANSITIONS]
    for count in (*short, *reversed(divisors[: len(divisors) - len(short)])):
        try:
            check(count)
        except SettingError:
            continue
        return count
    return whole
