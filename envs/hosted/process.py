"""The process of a Gymnasium environment, seen from this one."""

import contextlib
import os
import subprocess
import sys
import threading
import weakref
from pathlib import Path
from typing import Any

import numpy as np

from cgm_jax.envs.hosted.worker import receive, send

INTERPRETER = "CGM_JAX_GYMNASIUM_PYTHON"
"""Environment variable: the Python that has the task's packages, if it is not the running one."""

WORKER = Path(__file__).with_name("worker.py")


class HostedProcess:
    """Takes requests, one at a time, and ends with this process or before."""

    def __init__(self, name: str, env_id: str, module: str | None, trust: str) -> None:
        """Start the process, and have it look at the environment.

        Args:
            name: what the user calls the task, for messages.
            env_id: Gymnasium's name of the environment.
            module: what to import before, or None.
            trust: who has named the module, see `config.named.trust_of`.

        Raises:
            ValueError: the environment cannot be trained on; one line says why.
        """
        self.name = name
        self._lock = threading.Lock()  # XLA may run two callbacks at once
        python = other_interpreter()
        command = [python or sys.executable, str(WORKER)]
        try:
            self._process = subprocess.Popen(
                command,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                start_new_session=True,  # Ctrl-C is for this process
                env={**os.environ, "JAX_PLATFORMS": "cpu"},
            )
        except OSError as error:
            raise ValueError(f"env: {INTERPRETER}={python}: {error.strerror}") from None
        self._end = weakref.finalize(self, _end, self._process)
        path = None if python else sys.path
        values = {"id": env_id, "module": module, "name": name, "trust": trust}
        self.facts = self._ask("begin", [], path=path, **values)[0]

    def ask(self, op: str, *arrays: np.ndarray) -> list[np.ndarray]:
        """Arrays that answer a request.

        Raises:
            ValueError: the environment failed, or its process has ended.
        """
        return self._ask(op, list(arrays))[1]

    def _ask(
        self, op: str, arrays: list[np.ndarray], **values: Any
    ) -> tuple[dict[str, Any], list[np.ndarray]]:
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        with self._lock:
            try:
                send(self._process.stdin, op, arrays, **values)  # pyright: ignore
                message, answer = receive(self._process.stdout)  # pyright: ignore
            except (OSError, EOFError):
                code = self._process.wait()
                raise ValueError(f"env: the process of {self.name} ended with {code}") from None
        if message["op"] == "failed":
            text = message["text"]
            raise ValueError(text if text.startswith("env: ") else f"env: {self.name}: {text}")
        return message, answer


def other_interpreter() -> str | None:
    """The Python in which the task is to run, None for the running one."""
    return os.environ.get(INTERPRETER) or None


def _end(process: "subprocess.Popen[bytes]") -> None:
    for stream in (process.stdin, process.stdout):
        with contextlib.suppress(OSError):
            if stream is not None:
                stream.close()
    process.terminate()
    process.wait()
