"""JAX's own settings, made before it touches a device."""

import contextlib
import os
from pathlib import Path

import jax

from cgm_jax.config.fields import SettingError
from cgm_jax.host.devices import POOL_VARIABLE
from cgm_jax.machine.allotment import available_cores, share_cores

OPTIMISATION_LEVEL = "xla_backend_optimization_level"
"""LLVM's, for what XLA generates on a CPU. At 1 the training program compiles twice as fast as
at the default and runs no slower: its time goes into matrix products and physics, which are
libraries. It has no effect on a GPU.
"""


DEVICE_COUNT = "xla_force_host_platform_device_count"
"""A user's own flag for what `prepare_jax` is asked for."""


def prepare_jax(cpu_devices: int = 1) -> None:
    """Compile fast, keep compiled programs between processes, and give the same bits anywhere.

    Variables and flags that the user has set are left alone; `training.SELDOM_RUN` outranks them.

    Args:
        cpu_devices: how many devices of a CPU are to share the runs. JAX makes two if it is one:
            see `cgm_jax.loop.devices.team_of`. Has no effect on a GPU.

    Raises:
        SettingError: JAX_PLATFORMS names a device that JAX does not find.
    """
    flags = os.environ.get("XLA_FLAGS", "")
    if OPTIMISATION_LEVEL not in flags:
        os.environ["XLA_FLAGS"] = f"{flags} --{OPTIMISATION_LEVEL}=1".strip()
    if DEVICE_COUNT not in flags:
        with contextlib.suppress(RuntimeError):  # JAX has started; then it stays as it is
            jax.config.update("jax_num_cpu_devices", max(2, cpu_devices))
    os.environ.setdefault(POOL_VARIABLE, str(available_cores()))
    share_cores(cpu_devices)
    if "JAX_COMPILATION_CACHE_DIR" not in os.environ and (cache := _cache_directory()) is not None:
        jax.config.update("jax_compilation_cache_dir", str(cache))
    if "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS" not in os.environ:
        jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.3)
    _check_platform()


def _check_platform() -> None:
    """Start the device that JAX_PLATFORMS names, unless that is the CPU, which is there.

    A CPU is left for later, since the engine `mjx` sets a flag before it starts.

    Raises:
        SettingError: there is no such device, or JAX lacks the package for it.
    """
    asked = os.environ.get("JAX_PLATFORMS", "")
    if asked in ("", "cpu"):
        return
    try:
        jax.devices()
    except (RuntimeError, AssertionError):  # JAX asserts where the package is installed
        raise SettingError(
            f"JAX_PLATFORMS: JAX finds no device for {asked!r}; install the extra for it "
            "(cuda, and NVIDIA's driver), or unset the variable"
        ) from None


def _cache_directory() -> Path | None:
    """Where compiled programs are kept; None if there is no home to keep them in."""
    try:
        cache = Path.home() / ".cache" / "cgm_jax" / "xla"
        cache.mkdir(parents=True, exist_ok=True)
    except (RuntimeError, OSError):  # no HOME and no passwd entry; or not to be written to
        return None
    return cache if os.access(cache, os.W_OK) else None
