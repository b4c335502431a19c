"""FILE.py:NAME, a name in a file of the user's own: an environment, a curriculum, an agent."""

import hashlib
import importlib.util
import os
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

from cgm_jax.config.fields import SettingError


def is_own(name: str) -> bool:
    """Whether a setting's value names something in the user's own file."""
    return ".py" in name


def absolute(name: str) -> str:
    """A name that holds in any working directory."""
    # os.path keeps symbolic links.
    return os.path.abspath(name) if ".py:" in name else name  # noqa: PTH100


def load_named(setting: str, name: str) -> Any:
    """Load what FILE.py:NAME names.

    Raises:
        SettingError: there is no such file or name, or the file fails.
    """
    file, _, attribute = name.rpartition(":")
    path = Path(file)
    if not attribute or not path.is_file():
        raise SettingError(f"{setting}: {name!r} is not FILE.py:NAME with a file that exists")
    try:
        found = getattr(_load_module(setting, path), attribute, None)
    except SettingError:
        raise
    except Exception as error:  # whatever the user's code raises
        line = str(error).strip().partition("\n")[0]
        raise SettingError(
            f"{setting}: {name} fails with {type(error).__name__}: {line}"
        ) from error
    if not callable(found):
        raise SettingError(f"{setting}: {file} has no function or class {attribute!r}")
    return found


def _load_module(setting: str, path: Path) -> ModuleType:
    # Under a name of its own: a user's file may be called like any module of Python's.
    name = f"_named_{hashlib.sha256(str(path.resolve()).encode()).hexdigest()[:16]}"
    if name in sys.modules:
        return sys.modules[name]
    spec = importlib.util.spec_from_file_location(name, path)
    if spec is None or spec.loader is None:
        raise SettingError(f"{setting}: {path} is no Python file")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # so that dataclasses in the file find their module
    try:
        spec.loader.exec_module(module)
    except BaseException:
        del sys.modules[name]
        raise
    return module
