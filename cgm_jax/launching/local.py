"""Engine: processes on this machine, one per GPU or per group of cores, the rest in a queue."""

import os
import shutil
import subprocess
from collections.abc import Sequence

from cgm_jax.config.fields import SettingError
from cgm_jax.launching.attempts import Attempt
from cgm_jax.launching.directory import Launch, Resources
from cgm_jax.launching.supervision import Ended
from cgm_jax.machine.allotment import MEMORY_VARIABLE, available_cores, free_memory


class Local:
    """Processes on this machine; see `supervision.Engine`."""

    detached = ""

    _launch: Launch

    def __init__(self, parts: int, resources: Resources) -> None:
        """Share the machine out.

        Raises:
            SettingError: a part asks for more than there is.
        """
        there = [] if os.environ.get("JAX_PLATFORMS") == "cpu" else visible_gpus()
        self._hides = bool(there)
        self._gpus = there
        wanted = min(1, len(there)) if resources.gpus is None else resources.gpus
        cores = available_cores()
        if wanted > len(there):
            raise SettingError(f"gpus: {wanted} are more than the {len(there)} found here")
        if (resources.cores or 1) > cores:
            raise SettingError(f"cores: {resources.cores} are more than the {cores} given here")
        rooms = cores // (resources.cores or 1)
        if wanted:
            rooms = min(rooms, len(there) // wanted) if resources.cores else len(there) // wanted
        free, memory = free_memory(), resources.memory
        if memory is not None:
            if memory * 2**30 > free:
                raise SettingError(
                    f"memory: {memory:g} GiB are more than the {free / 2**30:.1f} free here"
                )
            rooms = min(rooms, int(free // (memory * 2**30)))
        self._wanted, self.rooms = wanted, min(parts, rooms)
        self.cores = resources.cores or max(1, cores // self.rooms)
        share = free / self.rooms / 2**20 if memory is None else memory * 2**10
        self._memory = max(1, int(share))
        self._attempts: dict[int, tuple[Attempt, list[str]]] = {}

    def check(self) -> None:
        """See `Engine`."""

    def variables_here(self) -> dict[str, str]:
        """See `Engine`."""
        return self._environment(self._gpus[: self._wanted])

    def _environment(self, gpus: Sequence[str]) -> dict[str, str]:
        """Variables of a part that has these GPUs."""
        environment = {MEMORY_VARIABLE: str(self._memory)}
        if self._hides:
            environment["CUDA_VISIBLE_DEVICES"] = ",".join(gpus)
        if self._hides and not gpus:
            environment["JAX_PLATFORMS"] = "cpu"
        return environment

    def begin(self, launch: Launch) -> None:
        """See `Engine`."""
        self._launch = launch

    def room(self) -> int:
        """See `Engine`."""
        return self.rooms - len(self._attempts)

    def start(self, parts: Sequence[int]) -> Sequence[int]:
        """See `Engine`."""
        for part in parts:
            gpus, self._gpus = self._gpus[: self._wanted], self._gpus[self._wanted :]
            environment = self._environment(gpus)
            order = self._launch.order(part, self.cores, environment, session=True)
            self._attempts[part] = Attempt(order), gpus
        return parts

    def ended(self) -> dict[int, Ended]:
        """See `Engine`."""
        ended = {}
        for part, (attempt, gpus) in list(self._attempts.items()):
            if (code := attempt.poll()) is not None:
                del self._attempts[part]
                self._gpus += gpus
                ended[part] = Ended(code)
        return ended

    def stop(self) -> None:
        """See `Engine`."""
        for attempt, _ in self._attempts.values():
            attempt.stop()


def visible_gpus() -> list[str]:
    """Names of the NVIDIA GPUs that this process may use, as CUDA_VISIBLE_DEVICES has them."""
    listed = os.environ.get("CUDA_VISIBLE_DEVICES")
    if listed is not None:
        return [name for name in listed.split(",") if name and name != "-1"]
    if shutil.which("nvidia-smi") is None:
        return []
    try:
        result = subprocess.run(
            ["nvidia-smi", "-L"], capture_output=True, text=True, timeout=60, check=False
        )
    except (OSError, subprocess.TimeoutExpired):
        return []
    count = sum(line.startswith("GPU ") for line in result.stdout.splitlines())
    return [str(number) for number in range(count)]
