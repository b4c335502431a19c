"""The environment that a setting names: a Fetch task, or one from the user's own file."""

import importlib.util
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import jax

import envs
from cgm_jax.settings import SettingError, Settings
from envs import GoalEnvironment

PROTOCOL = ("reset", "step", "action_size", "episode_length", "distance_threshold")
ENTRIES = {"observation", "achieved_goal", "desired_goal"}


def make_environment(settings: Settings) -> GoalEnvironment:
    """Make `settings.env`: a name in `envs.TASKS`, or FILE.py:FACTORY.

    FACTORY is called without arguments and returns a `GoalEnvironment`.

    Raises:
        SettingError: no such environment, engine, file or factory, or the factory's result
            lacks something that training needs.
    """
    if ".py" not in settings.env:
        fields = {}
        if settings.air_probability is not None:
            fields["air_probability"] = settings.air_probability
        try:
            return envs.make(settings.env, engine=settings.engine, **fields)
        except ValueError as error:
            raise SettingError(str(error)) from None
    return _from_file(settings.env)


def _from_file(name: str) -> GoalEnvironment:
    file, _, factory_name = name.rpartition(":")
    path = Path(file)
    if not factory_name or not path.is_file():
        raise SettingError(f"env: {name!r} is not FILE.py:FACTORY with a file that exists")
    factory = getattr(_load_module(path), factory_name, None)
    if not callable(factory):
        raise SettingError(f"env: {file} has no function or class {factory_name!r}")
    env: Any = factory()
    missing = [attribute for attribute in PROTOCOL if not hasattr(env, attribute)]
    if missing:
        raise SettingError(f"env: {name} lacks {', '.join(missing)}; see envs.GoalEnvironment")
    observation = jax.eval_shape(env.reset, jax.random.key(0)).obs
    if not isinstance(observation, dict) or not set(observation) >= ENTRIES:
        raise SettingError(f"env: State.obs of {name} is no dict with {', '.join(sorted(ENTRIES))}")
    return env


def _load_module(path: Path) -> ModuleType:
    spec = importlib.util.spec_from_file_location(path.stem, path)
    if spec is None or spec.loader is None:
        raise SettingError(f"env: {path} is no Python file")
    module = importlib.util.module_from_spec(spec)
    sys.modules[path.stem] = module  # so that dataclasses in the file find their module
    spec.loader.exec_module(module)
    return module
