"""How many devices share the runs of a sweep.

JAX makes as many devices of a CPU as it is asked for before it starts, and finds those of a GPU.
"""

from collections.abc import Sequence

from cgm_jax.config.fields import SettingError
from cgm_jax.config.grid import Group
from cgm_jax.machine.allotment import available_cores

ALL = "all"
MAX_CPU_DEVICES = 256
"""More than the cores of any machine; each takes threads."""

POOL_VARIABLE = "PJRT_NPROC"
"""How many threads XLA's pool on a CPU has, unless there are more devices. More than cores cost a
quarter of the time of an update; bits do not depend on them, see `cgm_jax.agents.products`."""


def parse_devices(text: str) -> int | None:
    """A number of devices; None for all of them.

    Raises:
        SettingError: it is neither.
    """
    if text == ALL:
        return None
    number = int(text) if text.isascii() and text.isdigit() and len(text) < 10 else 0
    if number < 1:
        raise SettingError(f"devices: {text!r} is neither a number of at least 1 nor {ALL}")
    return number


def cpu_devices(asked: int | None, groups: Sequence[Group]) -> int:
    """How many devices of a CPU share the runs: none without a run.

    Args:
        asked: for how many; None for one for each core.
        groups: of runs, which train one after another.
    """
    most = max(min(len(group.runs), group.settings.side_by_side) for group in groups)
    if asked is None:
        asked = available_cores()
    return min(asked, MAX_CPU_DEVICES, most)


def describe_devices() -> str:
    """What JAX computes on, as far as bits depend on it; starts JAX."""
    import jax

    devices, kind = jax.devices(), jax.devices()[0].device_kind
    return kind if kind == "cpu" else f"{len(devices)} x {kind}"


def check_devices(asked: int | None) -> None:
    """Check that there are as many devices as are asked for; starts JAX.

    Raises:
        SettingError: there are fewer, or on a CPU more are asked for than are made.
    """
    import jax

    there, platform = len(jax.devices()), jax.default_backend()
    limit = MAX_CPU_DEVICES if platform == "cpu" else there
    if asked is not None and asked > limit:
        raise SettingError(f"devices: {asked:,}, but the most on this {platform} are {limit}")
