"""The process of a Gymnasium environment, seen from this one."""

import atexit
import contextlib
import os
import subprocess
import sys
import threading
import weakref
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from cgm_jax.envs.hosted.worker import MessageError, receive, send

INTERPRETER = "CGM_JAX_GYMNASIUM_PYTHON"
"""Environment variable: the Python that has the task's packages, if it is not the running one."""

WORKER = Path(__file__).with_name("worker.py")

GRACE_S = 5.0
"""What an ending process may take to close its environments, and again to obey a signal."""

_running: "set[subprocess.Popen[bytes]]" = set()


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
        self._python = python or sys.executable
        try:
            self._process = subprocess.Popen(
                [self._python, str(WORKER)],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                start_new_session=True,  # Ctrl-C is for this process
                env={**os.environ, "JAX_PLATFORMS": "cpu"},
            )
        except OSError as error:
            raise ValueError(f"env: {INTERPRETER}={python}: {error.strerror}") from None
        _running.add(self._process)
        threading.Thread(target=_pass_on, args=[self._process.stderr], daemon=True).start()
        weakref.finalize(self, _end, self._process).atexit = False  # all end side by side there
        # Python passes over what is no text, such as a Path.
        path = None if python else [folder for folder in sys.path if isinstance(folder, str)]
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
                if self._process.stdin.closed:
                    raise EOFError
                send(self._process.stdin, op, arrays, **values)  # pyright: ignore
                message, answer = receive(self._process.stdout)  # pyright: ignore
            except BaseException as error:
                # What has been asked may still be answered, which would pass for the next answer.
                self._process.stdout.close()
                _end(self._process)
                if isinstance(error, MessageError):
                    raise ValueError(
                        f"env: {self.name}: what {self._python} prints is no answer; it must be a "
                        "Python that prints nothing by itself"
                    ) from None
                if not isinstance(error, OSError | EOFError):
                    raise
                code = self._process.returncode
                raise ValueError(f"env: the process of {self.name} ended with {code}") from None
        if message["op"] == "failed":
            text = message["text"]
            raise ValueError(text if text.startswith("env: ") else f"env: {self.name}: {text}")
        return message, answer


def _pass_on(printed: BinaryIO) -> None:
    """Pass on what an environment prints, until its process has ended.

    Read by us, it neither fails nor waits where nobody reads what we print. Written without
    Python's streams, whose locks a thread must not hold when the process ends.
    """
    with printed:
        while data := printed.read1(2**16):  # pyright: ignore
            with contextlib.suppress(OSError):
                os.write(2, data)


def other_interpreter() -> str | None:
    """The Python in which the task is to run, None for the running one."""
    return os.environ.get(INTERPRETER) or None


def _end(process: "subprocess.Popen[bytes]") -> None:
    """Have a process close its environments and end; force it, if it does not."""
    try:
        for stop in (_tell_to_end, subprocess.Popen.terminate, subprocess.Popen.kill):
            stop(process)
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(GRACE_S)
                break
    except BaseException:  # such as Ctrl-C, by one who does not want to wait
        process.kill()
        raise
    _running.discard(process)
    with contextlib.suppress(OSError):
        if process.stdout is not None:
            process.stdout.close()  # last, since another thread may read until its end


def _tell_to_end(process: "subprocess.Popen[bytes]") -> None:
    """Close its requests, after which it closes its environments and ends."""
    with contextlib.suppress(OSError):
        if process.stdin is not None:
            process.stdin.close()


@atexit.register
def _end_all() -> None:
    """End what still runs; all at once, so that many take no longer than one."""
    for process in list(_running):
        _tell_to_end(process)
    for process in list(_running):
        _end(process)
