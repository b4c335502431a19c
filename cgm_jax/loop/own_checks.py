"""An environment of the user's own is fit to be trained on, or one line says why it is not."""

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import Jaxpr, jaxprs_in_params

from cgm_jax.config.fields import SettingError
from cgm_jax.config.user_code import user_code
from cgm_jax.envs import GoalEnvironment, Stage
from cgm_jax.loop.own_environment import OwnEnvironment
from cgm_jax.loop.own_states import (
    ENTRIES,
    convertible,
    described,
    holds,
    path_text,
    unread_additions,
    with_unread_of,
)

PROTOCOL = ("reset", "step", "action_size", "episode_length", "distance_threshold")

ROUNDING = 1e-3
"""By which a reward may miss its range without a word."""

FEW_OPERATIONS = 2_000
"""A reset and a step of up to so many compile in seconds: they are run to look at their values."""


def checked(env: Any, name: str) -> GoalEnvironment:
    """Make an environment of the user's fit to be trained on.

    Shapes and types are found without running it; if it is small, values as well, by a reset and
    a step.

    Args:
        env: what the user's factory returned.
        name: what the user calls it, for messages.

    Raises:
        SettingError: it lacks something that training relies on; one line says what.
    """
    with user_code("env", name):
        missing = [attribute for attribute in PROTOCOL if not hasattr(env, attribute)]
    if missing:
        raise SettingError(f"env: {name} lacks {', '.join(missing)}; see envs.GoalEnvironment")
    with user_code("env", name):  # whatever it says of names that it need not have
        own = OwnEnvironment(env, name)
    _check_shapes(own, env, name)
    own.compiles_physics = _operations(own) > FEW_OPERATIONS
    if not own.compiles_physics:
        _check_values(own, name)
    return own  # pyright: ignore[reportReturnType] -- its State is not brax's


def _check_rules(own: OwnEnvironment, name: str, first: Any) -> None:
    """Trace the environment's own rules, without running them.

    Raises:
        SettingError: one fails, or returns something else than a scalar.
    """
    goal = jax.ShapeDtypeStruct(first.state.obs["desired_goal"].shape, np.float32)
    tolerance = getattr(own, "goal_tolerance", None)
    if tolerance is not None and tolerance.shape != goal.shape:
        raise SettingError(
            f"env: goal_tolerance of {name} has shape {tolerance.shape}, goals have {goal.shape}"
        )
    for rule in ("goal_success", "goal_reward", "is_terminal"):
        if not hasattr(own, rule):
            continue
        function = getattr(own, rule)
        with user_code("env", f"{rule} of {name}"):
            inputs = (first,) if rule == "is_terminal" else (goal, goal)
            shape = jax.eval_shape(function, *inputs).shape
            jax.eval_shape(jax.vmap(jax.vmap(function)), *_many(inputs))
        if shape != ():
            raise SettingError(f"env: {rule} of {name} returns shape {shape}, not a scalar")


def _check_shapes(own: OwnEnvironment, env: Any, name: str) -> None:
    """Trace reset and step without running them, alone and as training maps them.

    Raises:
        SettingError: see `checked`.
    """
    key = jax.random.key(0)
    with user_code("env", f"reset of {name}"):
        first = jax.eval_shape(env.reset, key)
    _check_entries(first, f"reset of {name}")
    _check_stages(own.stages, first.obs, name)
    action = jax.ShapeDtypeStruct((own.action_size,), np.float32)
    first = jax.eval_shape(own.reset, key)
    with user_code("env", f"step of {name}"):
        second = jax.eval_shape(env.step, first.state, action)
    _check_entries(second, f"step of {name}")
    _check_alike(first.state, with_unread_of(first.state, second), name, "step")
    if dropped := unread_additions(first.state, second):
        own.remarks.append(f"step of {name} adds {dropped[0]}, which reset lacks: it is not kept")
    _check_rules(own, name, first)
    if hasattr(own, "restart"):
        with user_code("env", f"restart of {name}"):
            again = jax.eval_shape(env.restart, first.state)
        _check_entries(again, f"restart of {name}")
        _check_alike(first.state, with_unread_of(first.state, again), name, "restart")
    with user_code("env", f"jax.vmap over reset and step of {name}"):
        keys = jax.eval_shape(lambda: jax.random.split(key, (2, 3)))
        actions = jax.ShapeDtypeStruct((2, 3, own.action_size), np.float32)
        many = jax.eval_shape(jax.vmap(jax.vmap(own.reset)), keys)
        jax.eval_shape(jax.vmap(jax.vmap(own.step)), many, actions)
    if hasattr(own, "restart"):
        with user_code("env", f"jax.vmap over restart of {name}"):
            jax.eval_shape(jax.vmap(jax.vmap(own.restart)), many)


def _many(shapes: Any) -> Any:
    """Shapes of what is mapped twice, as over environments and runs."""
    return jax.tree.map(lambda leaf: jax.ShapeDtypeStruct((2, 3, *leaf.shape), leaf.dtype), shapes)


def _check_stages(stages: Sequence[Stage], obs: dict[str, Any], name: str) -> None:
    """Check shapes of what stages achieve and desire.

    Raises:
        SettingError: they are not what the stage says.
    """
    seen = obs["observation"], obs["desired_goal"]
    for number, stage in enumerate(stages, start=1):
        functions = ((stage.achieved, obs["observation"]), (stage.desired, *seen))
        with user_code("env", f"stage {number} of {name}"):
            for function, *inputs in functions:
                jax.eval_shape(jax.vmap(jax.vmap(function)), *_many(inputs))
            results = {
                "achieved": jax.eval_shape(stage.achieved, obs["observation"]),
                "desired": jax.eval_shape(stage.desired, *seen),
            }
        for function, result in results.items():
            is_array = isinstance(result, jax.ShapeDtypeStruct)
            shown = described(result) if is_array else type(result).__name__
            is_real = is_array and jnp.issubdtype(result.dtype, jnp.floating)
            if not is_real or result.shape != (stage.size,):
                raise SettingError(
                    f"env: {function} of stage {number} of {name} returns {shown}, "
                    f"not float32[{stage.size}]"
                )


def _check_entries(state: Any, function: str) -> None:
    """Check shapes and types of what the trainer reads of a state's observation."""
    obs = getattr(state, "obs", None)
    if not hasattr(state, "replace"):
        raise SettingError(f"env: {function} returns {type(state).__name__}, not a brax State")
    if not isinstance(obs, dict) or not set(obs) >= set(ENTRIES):
        raise SettingError(f"env: {function}: State.obs is no dict with {', '.join(ENTRIES)}")
    for entry in ENTRIES:
        value = obs[entry]
        if not isinstance(value, jax.ShapeDtypeStruct):
            raise SettingError(f"env: {function}: {entry} is {type(value).__name__}, not an array")
        if not jnp.issubdtype(value.dtype, jnp.floating):
            raise SettingError(f"env: {function}: {entry} is {value.dtype}, not float32")
        if len(value.shape) != 1 or not value.shape[0]:
            raise SettingError(f"env: {function}: {entry} has shape {value.shape}, not [n]")
    achieved, desired = (obs[entry].shape for entry in ENTRIES[1:])
    if achieved != desired:
        raise SettingError(
            f"env: {function}: achieved_goal has shape {achieved} and desired_goal {desired}"
        )


def _check_alike(first: Any, second: Any, name: str, function: str) -> None:
    """Check that states after reset and after another function can take each other's place."""
    leaves = [jax.tree_util.tree_flatten_with_path(state)[0] for state in (first, second)]
    after_reset, after_step = ({path_text(path): leaf for path, leaf in part} for part in leaves)
    for path in sorted(set(after_reset) | set(after_step)):
        here, there = after_reset.get(path), after_step.get(path)
        if here is None or there is None or not _fits(here, there):
            raise SettingError(
                f"env: {path} of {name} is {described(here)} after reset "
                f"and {described(there)} after {function}"
            )
    if jax.tree.structure(first) != jax.tree.structure(second):
        raise SettingError(
            f"env: reset and {function} of {name} return states of different structure"
        )


def _fits(here: Any, there: Any) -> bool:
    """Whether a leaf can take another's place: as large, of the same kind, and with no loss."""
    return convertible(there, here) and (here.dtype == there.dtype or holds(here, there))


def _check_rewards(own: OwnEnvironment, obs: dict[str, np.ndarray], name: str) -> None:
    """Ask for the reward of a first state, and where the goal is met exactly, as in hindsight.

    Raises:
        SettingError: one is not finite.
    """
    if not hasattr(own, "goal_reward"):
        return
    achieved, desired = (obs[entry] for entry in ENTRIES[1:])
    for goal, where in ((desired, "in a first state"), (achieved, "where the goal is met exactly")):
        with user_code("env", f"running goal_reward of {name}"):
            reward = float(own.goal_reward(achieved, goal))
        if not np.isfinite(reward):
            raise SettingError(f"env: goal_reward of {name} is {reward} {where}")
        least, greatest = own.reward_range
        if not least - ROUNDING <= reward <= greatest + ROUNDING:
            own.remarks.append(
                f"goal_reward of {name} is {reward:g} {where}, beyond its reward_range of "
                f"{least:g} to {greatest:g}, to which rewards are cut"
            )


def _check_values(own: OwnEnvironment, name: str) -> None:
    """Run a reset and a step.

    Raises:
        SettingError: they fail, or the goal does not stay, or is too large for its threshold, or
            a reward is not finite.
    """

    def run() -> Any:
        @jax.jit  # anew, so that the user's functions are called again
        def first_two(key: jax.Array) -> Any:
            first = own.reset(key)
            return first.obs, own.step(first, jnp.zeros(own.action_size)).obs

        with user_code("env", f"running reset and step of {name}"):
            return jax.tree.map(np.asarray, jax.block_until_ready(first_two(jax.random.key(0))))

    states = run()
    for function, obs in zip(("reset", "step"), states, strict=True):
        for entry in ENTRIES:
            if not np.isfinite(obs[entry]).all():
                own.remarks.append(
                    f"{entry} is not finite after {function} of {name}; "
                    "episodes in which that happens are dropped"
                )
                return
    first, second = states
    _check_rewards(own, first, name)
    if not np.array_equal(first["desired_goal"], second["desired_goal"]):
        raise SettingError(f"env: step of {name} changes desired_goal, which holds for an episode")
    largest = np.abs(first["desired_goal"].astype(np.float32)).max()
    if np.spacing(largest) > own.distance_threshold:
        raise SettingError(
            f"env: distance_threshold of {name}, {own.distance_threshold:g}, is less than float32 "
            f"can tell apart at a desired_goal of {largest:g}"
        )
    again = jax.tree.map(np.array_equal, states, run())
    if not all(jax.tree.leaves(again)):
        own.remarks.append(
            f"reset and step of {name} give other values for the same key and action; "
            "what is trained with them cannot be repeated, nor resumed to the same bits"
        )


def _operations(own: OwnEnvironment) -> int:
    """How many operations a reset and a step have."""

    def run(key: jax.Array) -> Any:
        return own.step(own.reset(key), jnp.zeros(own.action_size))

    return _count(jax.make_jaxpr(run)(jax.random.key(0)).jaxpr)


def _count(jaxpr: Jaxpr) -> int:
    inner = [sub for equation in jaxpr.eqns for sub in jaxprs_in_params(equation.params)]
    return len(jaxpr.eqns) + sum(map(_count, inner))
