"""Engine: tasks on a Ray cluster that is there already; needs the extra `ray`.

A task starts one attempt as a process of the launcher's own interpreter, since the cluster's may
know nothing of this package, and passes on its exit code, or, if it is cancelled, SIGTERM. Ray
queues tasks until their resources are free; the task of a lost node is attempted anew elsewhere.
"""

import importlib
import sys
from collections.abc import Callable, Sequence
from typing import Any

from cgm_jax.config.fields import SettingError
from cgm_jax.launching.directory import Launch, Resources, carried_environment
from cgm_jax.launching.supervision import Ended
from cgm_jax.machine.allotment import MEMORY_VARIABLE


class Ray:
    """Tasks; see `supervision.Engine`."""

    detached = ""

    _launch: Launch

    def __init__(self, resources: Resources) -> None:
        """Connect to the cluster.

        Raises:
            SettingError: Ray is missing, or there is no cluster.
        """
        try:
            ray: Any = importlib.import_module("ray")
        except ImportError:
            raise SettingError(
                "on: ray needs Ray, which the extra installs: pip install '.[ray]'"
            ) from None
        try:
            ray.init(
                address=resources.address,
                log_to_driver=False,
                logging_level="error",
                ignore_reinit_error=True,
            )
        except (ConnectionError, RuntimeError, ValueError) as error:
            text = str(error).strip().partition("\n")[0]
            raise SettingError(f"address: no Ray cluster at {resources.address}: {text}") from None
        self._ray = ray
        self._cores = resources.cores or 1
        self._tasks: dict[Any, int] = {}
        self._nowhere: dict[int, str] = {}
        # Ray only keeps account of memory; a part has to be told what it may plan with.
        memory = resources.memory
        self._memory = {} if memory is None else {MEMORY_VARIABLE: str(int(memory * 2**10))}
        options = {
            "num_cpus": self._cores,
            "num_gpus": resources.gpus,
            "memory": None if resources.memory is None else int(resources.memory * 2**30),
            # The launcher's own rule says when to try again: only while there is progress.
            "max_retries": 0,
        }
        given = {name: value for name, value in options.items() if value is not None}
        self._attempt = ray.remote(**given)(_make_attempt())

    def check(self) -> None:
        """See `Engine`; to connect was to ask."""

    def variables_here(self) -> None:
        """See `Engine`."""

    def begin(self, launch: Launch) -> None:
        """See `Engine`."""
        self._launch = launch

    def room(self) -> int:
        """See `Engine`."""
        return self._launch.parts

    def start(self, parts: Sequence[int]) -> Sequence[int]:
        """See `Engine`."""
        carried = {**carried_environment(), **self._memory}
        for part in parts:
            order = self._launch.order(part, self._cores, carried)
            task = self._attempt.remote(
                sys.executable, order.to_json(), carried, order.cwd, str(self._launch.path)
            )
            self._tasks[task] = part
        return parts

    def ended(self) -> dict[int, Ended]:
        """See `Engine`.

        Raises:
            SettingError: no node that has been given a part can run one.
        """
        if not self._tasks:
            return {}
        ready, _ = self._ray.wait(list(self._tasks), num_returns=len(self._tasks), timeout=0)
        taken = {task: self._tasks.pop(task) for task in ready}
        ended = {part: Ended(self._code(task, part)) for task, part in taken.items()}
        if not self._tasks and len(self._nowhere) == self._launch.parts:
            raise SettingError(f"on: {next(iter(self._nowhere.values()))}")
        return ended

    def _code(self, task: Any, part: int) -> int | None:
        """A task's exit code; None if it has none, since its worker or node was lost.

        Of a node that cannot run parts it says why: others may be able to.
        """
        try:
            code = int(self._ray.get(task))
            self._nowhere.pop(part, None)
            return code
        except self._ray.exceptions.RayError as error:
            cause = getattr(error, "cause", None)
            if isinstance(cause, FileNotFoundError):
                print(f"on: {cause}", file=sys.stderr)
                self._nowhere[part] = str(cause)
            return None  # lost, or cancelled

    def stop(self) -> None:
        """See `Engine`."""
        for task in self._tasks:
            self._ray.cancel(task)


def _make_attempt() -> Callable[..., int]:
    """The task, with all that it needs inside: workers know nothing of this package."""

    def attempt(interpreter: str, order: str, carried: dict[str, str], cwd: str, out: str) -> int:
        import os
        import socket
        import subprocess
        import time

        host = socket.gethostname()
        for path, what in ((interpreter, "interpreter"), (out, "directory")):
            if not os.path.exists(path):  # noqa: PTH110
                raise FileNotFoundError(f"the {what} {path} is not there on {host}")
        child = subprocess.Popen(
            [interpreter, "-m", "cgm_jax.launching.attempts", order],
            # Not in the directory of the launch: Python imports from where it is started.
            cwd=cwd if os.path.isdir(cwd) else os.sep,  # noqa: PTH112
            env={**os.environ, **carried},
        )
        try:
            while child.poll() is None:  # polled, so that a cancellation gets through
                time.sleep(0.2)
        except KeyboardInterrupt:
            child.terminate()
            deadline = time.monotonic() + 20
            while child.poll() is None and time.monotonic() < deadline:
                time.sleep(0.2)
            raise
        return child.returncode

    return attempt
