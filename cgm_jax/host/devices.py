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
    """How many devices to make of a CPU: one for each core, but none without a run.

    Args:
        asked: for how many; None for all.
        groups: of runs, which train one after another.
    """
    most = max(min(len(group.runs), group.settings.side_by_side) for group in groups)
    return min(available_cores() if asked is None else min(asked, MAX_CPU_DEVICES), most)


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
