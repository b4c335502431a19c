"""Settings for all tests; imported by pytest before anything of JAX."""

import atexit
import gc
import os
import shutil
import signal
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

# Tests compile many small programs and run them briefly.
os.environ.setdefault(
    "XLA_FLAGS", "--xla_backend_optimization_level=0 --xla_cpu_use_fusion_emitters=false"
)
os.environ.setdefault("JAX_PLATFORMS", "cpu")

# What tests name on their command lines is not named by whoever runs them.
os.environ["XDG_STATE_HOME"] = tempfile.mkdtemp(prefix="cgm_jax-tests-")
atexit.register(shutil.rmtree, os.environ["XDG_STATE_HOME"], ignore_errors=True)

# Tracing makes millions of objects that live briefly; the search for cycles among them took a tenth
# of the time.
gc.set_threshold(100_000, 20, 50)

# In the background, or below nohup, a process ignores these, and so would those that tests start.
for _number, _action in (
    (signal.SIGINT, signal.default_int_handler),
    (signal.SIGHUP, signal.SIG_DFL),
):
    if signal.getsignal(_number) is signal.SIG_IGN:
        signal.signal(_number, _action)

from jaxtyping import install_import_hook  # noqa: E402

from tests import typechecking  # noqa: E402

# Shapes and types that annotations in these rooms tell are checked at every call in tests.
CHECKED = (
    *(f"cgm_jax.{room}" for room in ("agents", "curricula", "replay", "loop")),
    "cgm_jax.envs.goals",
)
# By a name of its own: pytest makes another module `tests` than the one that this imports.
sys.modules["typechecking"] = typechecking
install_import_hook(CHECKED, "typechecking.check")

import jax  # noqa: E402
import pytest  # noqa: E402

import cgm_jax.envs.quiet_import  # noqa: E402, F401 -- ahead of Brax, whose imports it silences
from cgm_jax.config.user_code import Neighbours  # noqa: E402

# Programs of this process are not worth keeping; those of processes that tests start are.
jax.config.update("jax_enable_compilation_cache", False)


@pytest.fixture
def strict() -> Iterator[None]:
    """No type is promoted to another unless the code says so."""
    with jax.numpy_dtype_promotion("strict"):
        yield


TOGETHER = {
    "host": ("tests/cgm_jax/host/",),
    "training": tuple(
        f"tests/cgm_jax/loop/test_{name}.py" for name in ("training", "compiler", "divergence")
    ),
    "agents": ("tests/cgm_jax/agents/", "tests/cgm_jax/storage/test_policies.py"),
}
"""Files that share what they compile: one process runs all of a group."""


@pytest.hookimpl(optionalhook=True)  # pytest-xdist's, which may be absent
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Any:
    """With `--dist loadfile`, have one process run a group of `TOGETHER` as if it were a file.

    Not `--dist loadgroup`: pytest-xdist 3.8 finds no groups with pytest 9.2.
    """
    from xdist.scheduler import LoadFileScheduling

    class LoadGroupsOfFiles(LoadFileScheduling):
        def _split_scope(self, nodeid: str) -> str:
            groups = (name for name, files in TOGETHER.items() if nodeid.startswith(files))
            return next(groups, super()._split_scope(nodeid))

    return LoadGroupsOfFiles(config, log) if config.getvalue("dist") == "loadfile" else None


MAPS, MANY_MAPS = Path("/proc/self/maps"), 30_000
"""Where a process's memory maps are listed, and how many of the 65,530 it may have are many."""


@pytest.fixture(scope="module", autouse=True)
def forgotten_programs() -> Iterator[None]:
    """Drop what was compiled once a process has many memory maps, of which programs take some."""
    yield
    if not MAPS.exists() or MAPS.read_bytes().count(b"\n") > MANY_MAPS:
        jax.clear_caches()


@pytest.fixture(scope="module", autouse=True)
def forgotten_neighbours() -> Iterator[None]:
    """A file's tests find no modules beside files that another file's tests have named."""
    yield
    for finder in [one for one in sys.meta_path if isinstance(one, Neighbours)]:
        finder.forget(finder.found)
        sys.meta_path.remove(finder)
