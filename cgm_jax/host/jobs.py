"""What is to be trained: groups of runs, with the programs that train them, as memory allows."""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

from cgm_jax.config.fields import SettingError
from cgm_jax.config.grid import Group, Run, split, structure
from cgm_jax.config.settings import Settings
from cgm_jax.config.spelling import counted
from cgm_jax.envs import GoalEnvironment
from cgm_jax.host.memory import estimate_memory, format_bytes, not_counted, runs_that_fit
from cgm_jax.loop.cutting import WHOLE, Parts
from cgm_jax.loop.devices import Device, share
from cgm_jax.loop.environment import make_environment, remarks_on
from cgm_jax.loop.own_components import check_components
from cgm_jax.loop.training import Programs, Trainer, make_programs, make_trainer


@dataclass(frozen=True)
class Job:
    """Runs that train side by side, the programs that train them, and how those cut cycles."""

    group: Group
    programs: Programs
    parts: Parts = WHOLE


def plan_jobs(
    groups: Sequence[Group], devices: Sequence[Device], *, planned: bool = False
) -> tuple[list[Job], list[str]]:
    """Build what groups need, split those that do not fit into memory, and say what they take.

    Parts of one group share their programs, so that equal parts compile once.

    Args:
        groups: the parts of one program next to each other.
        devices: that share the runs of each.
        planned: whether they are the parts of an earlier plan. Those stay, whatever the memory
            is today: a checkpoint holds the runs of a part.

    Returns:
        Jobs in order, and one line per program.

    Raises:
        SettingError: an environment cannot be made, a run does not fit into memory, or a count
            would overflow.
    """
    jobs, notes = [], []
    environments: dict[Settings, GoalEnvironment] = {}
    for _, same in itertools.groupby(groups, key=_program):
        parts, made = list(same), dict[int, Programs]()
        settings, runs = parts[0].settings, [run for part in parts for run in part.runs]
        if settings not in environments:
            environments[settings] = make_environment(settings)
        trainer = make_trainer(environments[settings], settings)
        _check_counters(trainer)
        check_components(trainer, runs[0])
        remarks = [*remarks_on(trainer.setup.env), *_remarks_on_discount(trainer, runs)]
        notes += [remark for remark in remarks if remark not in notes]
        cut, estimate = trainer.parts(runs[0].hyper), estimate_memory(trainer, runs[0].hyper)
        if not planned:
            (whole,) = parts
            fitting = runs_that_fit(estimate, len(runs), len(devices))
            parts = split(whole, min(fitting, settings.side_by_side))
        for part in parts:
            count = share(len(part.runs), len(devices)).devices
            if count not in made:
                made[count] = make_programs(trainer, devices[:count])
            jobs.append(Job(part, made[count], cut))
        largest = max(len(part.runs) for part in parts)
        note = f"{settings.env}: memory for {counted(len(runs), 'run')}"
        if len(parts) > 1:
            note += f", {largest} at a time"
        note += f": {format_bytes(estimate.total(largest, len(devices)))}"
        if (sharing := share(largest, len(devices)).devices) > 1:
            note += f" on {'each of ' if not estimate.on_cpu else ''}{sharing} devices"
        notes.append(note + not_counted(trainer.setup.env))
    return jobs, notes


def _program(group: Group) -> object:
    """What groups of one program have in common."""
    return structure(group.settings, group.runs[0].hyper)


def _remarks_on_discount(trainer: Trainer, runs: Sequence[Run]) -> list[str]:
    """What to say of runs that bootstrap from states in which they never act.

    The critic knows a state's value from the actions taken in it. With one step to an episode none
    is ever taken in the state that follows, whose value then drifts and takes the others along.
    """
    settings, episode_length = trainer.setup.settings, trainer.setup.env.episode_length
    discount = max((run.values.get("discount", 0.0) for run in runs), default=0.0)
    if episode_length > 1 or not discount:
        return []
    return [
        f"{settings.env}: its episodes have one step, so that there is no next state to bootstrap "
        f"from: give --discount 0 instead of {discount:g}"
    ]


def _check_counters(trainer: Trainer) -> None:
    """Refuse to train for longer than the int32 counters of a run can count.

    Raises:
        SettingError: it would take 2^31 environment steps or updates.
    """
    settings, env = trainer.setup.settings, trainer.setup.env
    cycles = settings.epochs * settings.cycles_per_epoch
    steps = settings.environments * env.episode_length
    totals = {"env_steps": cycles * steps, "updates": cycles * settings.updates_per_cycle}
    for name, count in totals.items():
        if count >= 2**31:
            raise SettingError(f"epochs: {count:,} {name} in all are more than 2^31 - 1")
