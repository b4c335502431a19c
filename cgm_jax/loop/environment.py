"""The environment that a setting names: a Fetch task, or one from the user's own file.

And what the project's own environments, and the wrapper around a user's, say of how they are
computed, beside `envs.GoalEnvironment`.
"""

import shlex

import jax

from cgm_jax import envs
from cgm_jax.config.fields import SettingError
from cgm_jax.config.named import (
    FROM_CONFIG,
    gymnasium_name,
    is_gymnasium,
    is_own,
    load_named,
    note_hosted,
    trust_of,
)
from cgm_jax.config.settings import Settings
from cgm_jax.config.user_code import user_code
from cgm_jax.envs import GoalEnvironment
from cgm_jax.envs.fetch import FetchEnvironment
from cgm_jax.envs.hosted.process import INTERPRETER, HostedProcess, other_interpreter
from cgm_jax.envs.hosted.task import HostedTask
from cgm_jax.loop.own_checks import checked


def make_environment(settings: Settings) -> GoalEnvironment:
    """Make `settings.env`: a name in `envs.TASKS`, FILE.py:NAME or package.module:NAME.

    NAME is called without arguments and returns a `GoalEnvironment`. gymnasium:ID, or
    gymnasium:MODULE:ID, is an environment of Gymnasium's.

    Raises:
        SettingError: no such environment, engine, file or factory; a setting that the
            environment has no use for; or the factory fails or its result lacks something that
            training needs.
    """
    if is_own(settings.env):
        if settings.engine != "auto" or settings.air_probability is not None:
            raise SettingError("env: --engine and --air-probability are for the Fetch tasks")
        if is_gymnasium(settings.env):
            return _hosted(settings.env)
        return _from_file(settings.env)
    if settings.env not in envs.TASKS:
        choices = ", ".join(envs.TASKS)
        raise SettingError(
            f"env: unknown environment {settings.env!r}; choose from {choices}, FILE.py:NAME of "
            "your own, or gymnasium:ID"
        )
    fields = {}
    if settings.air_probability is not None:
        fields["air_probability"] = settings.air_probability
    try:
        return envs.make(settings.env, engine=settings.engine, **fields)
    except ValueError as error:
        raise SettingError(str(error)) from None


def remarks_on(env: GoalEnvironment) -> list[str]:
    """Lines about what an environment may do, though it is hardly meant."""
    return getattr(env, "remarks", [])


def compiles_physics(env: GoalEnvironment) -> bool:
    """Whether an environment has XLA compile its physics, as MJX and Brax do.

    The native engine calls MuJoCo instead, and an environment of few operations does not count.
    """
    return getattr(env, "compiles_physics", False)


def calls_physics(env: GoalEnvironment) -> bool:
    """Whether an environment calls its physics outside of XLA: MuJoCo's own, or another process."""
    return getattr(env, "calls_physics", False)


def compiler_options(env: GoalEnvironment) -> dict[str, bool]:
    """XLA's options for programs that have an environment in them."""
    return dict(getattr(env, "compiler_options", {}))


def is_hosted(env: GoalEnvironment) -> bool:
    """Whether an environment's episodes are simulated in another process, one simulator each."""
    return getattr(env, "is_hosted", False)


def _hosted(name: str) -> GoalEnvironment:
    """A Gymnasium goal environment, in a process of its own."""
    module, env_id = gymnasium_name(name)
    if jax.default_backend() != "cpu":
        raise SettingError("env: gymnasium: needs JAX on a CPU; set JAX_PLATFORMS=cpu")
    trust = trust_of(name)
    if module is not None and other_interpreter() and trust == FROM_CONFIG:
        raise SettingError(f"env: name it, since {INTERPRETER} runs it: --env {shlex.quote(name)}")
    try:
        process = HostedProcess(name, env_id, module, trust)
    except ValueError as error:
        raise SettingError(str(error)) from None
    note_hosted(name, **process.facts["runs_on"])
    return HostedTask(process)  # pyright: ignore[reportReturnType] -- its State is not brax's


def _from_file(name: str) -> GoalEnvironment:
    factory = load_named("env", name)
    with user_code("env", name):
        env = factory()
    if type(env) is FetchEnvironment:  # with other values, which it checks itself
        return env
    own = checked(env, name)
    return env if isinstance(env, FetchEnvironment) else own  # compiled and rendered as what it is
