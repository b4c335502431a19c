"""Whether own curricula, agents and ways to relabel return what their protocols say.

Shapes and types only: nothing is run or compiled. Arrays of another shape than was meant often go
together all the same, by broadcasting, and something else is trained.
"""

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from cgm_jax.agents.networks import apply_actor
from cgm_jax.config.fields import SettingError
from cgm_jax.config.settings import Hyperparameters
from cgm_jax.curricula.protocol import Goals
from cgm_jax.loop.cycle import view_of
from cgm_jax.loop.learning import minibatches
from cgm_jax.loop.own_states import convertible, described
from cgm_jax.loop.rollout import drawn_goals, reset
from cgm_jax.loop.setup import Setup, sizes
from cgm_jax.loop.state import TrainingState
from cgm_jax.replay.protocol import Transitions

OPTIONAL = ("next_achieved", "continues", "subgoal", "next_subgoal")
"""Entries of transitions that may be None."""


def check_curriculum(what: str, setup: Setup, state: TrainingState, hyper: Hyperparameters) -> None:
    """Check what a curriculum returns, but for its state.

    Args:
        what: the curriculum, for messages.
        setup: the environment and the static settings.
        state: shapes of a run's.
        hyper: of the run.

    Raises:
        SettingError: it is something else than the protocol says.
    """
    count, known, key = setup.settings.environments, sizes(setup, hyper), jax.random.key(0)
    first = jax.eval_shape(lambda key: reset(setup.env, key, count), key)
    goals = jax.eval_shape(partial(_sampled, setup), state, hyper, key, first)
    if not isinstance(goals, Goals):
        raise SettingError(f"{what}: what sample returns is {_shown(goals)}, not Goals")
    _check(f"{what}: desired of sample", goals.desired, (count, known.goal))
    _check(f"{what}: mask of sample", goals.mask, (count, known.goal))
    _check(f"{what}: threshold of sample", goals.threshold, (count,))
    if goals.start is not None:
        _check_start(f"{what}: start of sample", setup, goals.start, first)
    masks = jax.eval_shape(lambda one: one.examination(known), hyper.curriculum)
    if masks is not None:
        number = getattr(masks, "shape", ())[:1]
        _check(f"{what}: what examination returns", masks, (*number, known.goal))

    def report(curriculum: Any, own: Any) -> Any:
        reported = curriculum.report(own)
        if not isinstance(reported, Mapping):
            raise SettingError(f"{what}: what report returns is {_shown(reported)}, not a dict")
        for name, value in reported.items():
            if not isinstance(value, jax.Array | np.ndarray | np.generic | float | int):
                raise SettingError(f"{what}: {name} of report is {_shown(value)}, not an array")
        return dict(reported)

    jax.eval_shape(report, hyper.curriculum, state.curriculum)


def check_agent(what: str, setup: Setup, state: TrainingState, hyper: Hyperparameters) -> None:
    """Check what an agent returns, but for its state; arguments and errors as above."""
    count, known, key = setup.settings.environments, sizes(setup, hyper), jax.random.key(0)
    inputs = jax.ShapeDtypeStruct((count, known.inputs), jnp.float32)
    action = _of(hyper.agent, "act", state.agent, inputs, key if hyper.agent.explores else None)
    _check(f"{what}: what act returns", action, (count, known.action))
    value = _of(hyper.agent, "value", state.agent, inputs, action)
    _check(f"{what}: what value returns", value, (known.critics, count))
    _check_actor(what, _of(hyper.agent, "actor", state.agent), inputs, known.action)
    batches = jax.eval_shape(partial(minibatches, setup), state, hyper, key)
    trained = _of(hyper.agent, "train", state.agent, batches, key)
    is_pair = isinstance(trained, tuple) and len(trained) == 2
    if not is_pair or not isinstance(trained[1], Mapping):
        raise SettingError(f"{what}: train returns something else than a state and a dict")
    if lacking := [name for name in hyper.agent.logged if name not in trained[1]]:
        there = ", ".join(trained[1]) or "nothing"
        raise SettingError(f"{what}: logged has {lacking[0]}, but what train returns has {there}")


def check_relabelling(
    what: str, setup: Setup, state: TrainingState, hyper: Hyperparameters
) -> None:
    """Check what a way to relabel draws; arguments and errors as above."""
    known, stages, key = sizes(setup, hyper), setup.stages, jax.random.key(0)
    count = known.updates_at_once * setup.settings.batch_size
    drawn = jax.eval_shape(
        lambda one, key, replay: one.sample(key, replay, count, known.distance_threshold, stages),
        hyper.relabelling,
        key,
        state.replay,
    )
    if not isinstance(drawn, Transitions):
        raise SettingError(f"{what}: what sample returns is {_shown(drawn)}, not Transitions")
    shown = hyper.relabelling.shows(stages)
    shapes = {
        **dict.fromkeys(("observation", "next_observation"), (known.observation,)),
        **dict.fromkeys(("goal", "next_goal", "mask", "next_achieved"), (known.goal,)),
        **dict.fromkeys(("threshold", "reward", "continues"), ()),
        **dict.fromkeys(("subgoal", "next_subgoal"), (shown,)),
        "action": (known.action,),
    }
    for name, shape in shapes.items():
        entry = getattr(drawn, name)
        if entry is not None or name not in OPTIONAL:
            _check(f"{what}: {name} of sample", entry, (count, *shape))


def _sampled(
    setup: Setup, state: TrainingState, hyper: Hyperparameters, key: jax.Array, first: Any
) -> Any:
    """What a curriculum makes of the goals of environments after their reset."""
    view = view_of(setup, state, hyper, first)
    return hyper.curriculum.sample(state.curriculum, key, drawn_goals(setup.env, first), view)


def _of(agent: Any, function: str, *arguments: Any) -> Any:
    """Shapes of what a function of an agent returns."""
    return jax.eval_shape(lambda one, *rest: getattr(one, function)(*rest), agent, *arguments)


def _check_actor(what: str, actor: Any, inputs: jax.ShapeDtypeStruct, size: int) -> None:
    """Check that `apply_actor` makes actions [..., size] of an actor and inputs."""
    try:
        action = jax.eval_shape(apply_actor, actor, inputs)
    except Exception as error:  # of many kinds, as something is missing or does not fit
        raise SettingError(
            f"{what}: actor returns no parameters of networks.Actor for inputs {described(inputs)}"
        ) from error
    _check(f"{what}: the action of what actor returns", action, (inputs.shape[0], size))


def _check_start(what: str, setup: Setup, start: Any, first: Any) -> None:
    """Check that episodes can begin in states that a curriculum chose."""
    if not hasattr(setup.env, "restart"):
        raise SettingError(f"{what} needs an environment with restart")
    if jax.tree.structure(start) != jax.tree.structure(first) or not all(
        map(convertible, jax.tree.leaves(start), jax.tree.leaves(first))
    ):
        count = setup.settings.environments
        raise SettingError(f"{what} is not {count} states as reset and step return them")


def _check(what: str, returned: Any, shape: Sequence[int]) -> None:
    """Check that something is an array of floating-point numbers of a shape.

    Raises:
        SettingError: it is not; the line has both.
    """
    expected = jax.ShapeDtypeStruct(shape, jnp.float32)
    if not isinstance(returned, jax.ShapeDtypeStruct) or not convertible(returned, expected):
        raise SettingError(f"{what} is {_shown(returned)}, not {described(expected)}")


def _shown(returned: Any) -> str:
    if isinstance(returned, jax.ShapeDtypeStruct | jax.Array):
        return described(returned)
    return "None" if returned is None else f"of type {type(returned).__name__}"
