"""The environment that a setting names: a Fetch task, or one from the user's own file."""

from typing import Any

import jax

from cgm_jax import envs
from cgm_jax.config.fields import SettingError
from cgm_jax.config.named import is_own, load_named
from cgm_jax.config.settings import Settings
from cgm_jax.envs import GoalEnvironment

PROTOCOL = ("reset", "step", "action_size", "episode_length", "distance_threshold")
ENTRIES = ("observation", "achieved_goal", "desired_goal")


def make_environment(settings: Settings) -> GoalEnvironment:
    """Make `settings.env`: a name in `envs.TASKS`, or FILE.py:FACTORY.

    FACTORY is called without arguments and returns a `GoalEnvironment`.

    Raises:
        SettingError: no such environment, engine, file or factory; a setting that the
            environment has no use for; or the factory fails or its result lacks something that
            training needs.
    """
    if is_own(settings.env):
        if settings.engine != "auto" or settings.air_probability is not None:
            raise SettingError("env: --engine and --air-probability are for the Fetch tasks")
        return _from_file(settings.env)
    fields = {}
    if settings.air_probability is not None:
        fields["air_probability"] = settings.air_probability
    try:
        return envs.make(settings.env, engine=settings.engine, **fields)
    except ValueError as error:
        raise SettingError(str(error)) from None


def _from_file(name: str) -> GoalEnvironment:
    factory = load_named("env", name)
    try:
        env: Any = factory()
        _check_protocol(env, name)
    except SettingError:
        raise
    except Exception as error:  # whatever the user's code raises
        line = str(error).strip().partition("\n")[0]
        raise SettingError(f"env: {name} fails with {type(error).__name__}: {line}") from error
    return env


def _check_protocol(env: Any, name: str) -> None:
    """Try reset and step without running them.

    Raises:
        SettingError: the environment lacks what training needs.
    """
    if missing := [attribute for attribute in PROTOCOL if not hasattr(env, attribute)]:
        raise SettingError(f"env: {name} lacks {', '.join(missing)}; see envs.GoalEnvironment")
    first = jax.eval_shape(env.reset, jax.random.key(0))
    if not isinstance(first.obs, dict) or not set(first.obs) >= set(ENTRIES):
        raise SettingError(f"env: State.obs of {name} is no dict with {', '.join(ENTRIES)}")
    achieved, desired = (first.obs[entry].shape for entry in ENTRIES[1:])
    if achieved != desired or len(desired) != 1:
        raise SettingError(f"env: goals of {name} have shapes {achieved} and {desired}, not [n]")
    action = jax.ShapeDtypeStruct((env.action_size,), "float32")
    second = jax.eval_shape(env.step, first, action)
    if jax.tree.structure(first) != jax.tree.structure(second):
        raise SettingError(f"env: reset and step of {name} return states of different structure")
