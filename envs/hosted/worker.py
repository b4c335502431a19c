"""The process in which a Gymnasium environment lives. Speaks on its standard input and output.

Messages: a line of JSON with `op`, further values, and `arrays`, the type and shape of each array
whose bytes follow. Needs numpy and gymnasium; of cgm_jax only where the task's module is checked
against what its user has named (config/named.py).
"""

import contextlib
import importlib
import importlib.metadata
import importlib.util
import json
import math
import os
import platform
import signal
import sys
import traceback
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

if TYPE_CHECKING:  # an interpreter without numpy is to say so, as `begin` does
    import numpy as np

CLOSING_S = 10
"""What closing the environments may take, though nobody may be left to wait for it."""


class MessageError(Exception):
    """What was read is no message of ours."""


def send(stream: BinaryIO, op: str, arrays: "list[np.ndarray]", **values: Any) -> None:
    """Write one message."""
    described = [[array.dtype.str, array.shape] for array in arrays]
    stream.write(json.dumps({"op": op, **values, "arrays": described}).encode() + b"\n")
    for array in arrays:
        stream.write(array.tobytes())
    stream.flush()


def receive(stream: BinaryIO) -> "tuple[dict[str, Any], list[np.ndarray]]":
    """Read one message.

    Raises:
        EOFError: the other side has ended.
        MessageError: it does not speak as this one.
    """
    line = stream.readline()
    if not line.endswith(b"\n"):
        raise EOFError
    try:
        message = json.loads(line)
    except ValueError:
        raise MessageError from None
    if not (isinstance(message, dict) and {"op", "arrays"} <= set(message)):
        raise MessageError
    return message, [_read_array(stream, *described) for described in message["arrays"]]


def _read_array(stream: BinaryIO, kind: str, shape: list[int]) -> "np.ndarray":
    """Read one array of a message.

    Raises:
        EOFError: the other side has ended.
    """
    import numpy as np

    count = math.prod(shape) * np.dtype(kind).itemsize
    data = stream.read(count)
    if len(data) < count:
        raise EOFError
    return np.frombuffer(data, kind).reshape(shape)


def main() -> None:
    """Serve until the other side ends, then close what was made."""
    requests, replies = taken_pipes()
    here = Path(__file__).resolve().parent  # whose files are nobody's modules
    if Path(sys.path[0]).resolve() == here:
        del sys.path[0]
    rows = None
    try:
        while True:
            message, arrays = receive(requests)
            op, answer, values = "done", [], {}
            try:
                if message["op"] == "begin":
                    rows = begin(message)
                    op, values = "facts", {**rows.facts, "runs_on": runs_on(message)}
                else:
                    answer = serve(rows, message["op"], arrays)
            except Exception as error:
                op, values = "failed", {"text": described(error)}
            send(replies, op, answer, **values)
    except (EOFError, BrokenPipeError):
        pass  # the other side has ended
    finally:
        signal.alarm(CLOSING_S)  # ends this process, unless it has ended by then
        with contextlib.suppress(OSError):
            replies.close()
        if rows is not None:
            rows.close()


def taken_pipes() -> tuple[BinaryIO, BinaryIO]:
    """Requests and replies, out of reach of what the environment reads, prints or starts."""
    requests, replies = os.fdopen(os.dup(0), "rb"), os.fdopen(os.dup(1), "wb")
    with Path(os.devnull).open("rb") as nothing:
        os.dup2(nothing.fileno(), 0)
    os.dup2(2, 1)  # what the environment prints is no reply
    return requests, replies


def described(error: Exception) -> str:
    """What failed, in one line, and where, if it is none of our refusals."""
    line = str(error).partition("\n")[0]
    if type(error).__name__ in ("TaskError", "SettingError"):
        return line
    place = traceback.extract_tb(error.__traceback__)[-1]
    return f"{type(error).__name__}: {line} ({place.filename}, line {place.lineno})"


def begin(message: dict[str, Any]) -> Any:
    """Import the task's module, if it has one, and look at its environment.

    Raises:
        ImportError: this interpreter lacks what is needed.
    """
    try:
        rows = own_package().rows  # with Gymnasium, before the task's folders are searched
    except ImportError as error:
        raise ImportError(f"{sys.executable} needs numpy and gymnasium: {error}") from None
    from_here = message["path"] is not None
    safe = getattr(sys.flags, "safe_path", False)  # from Python 3.11 on
    path = ([] if safe else [""]) if message["path"] is None else message["path"]
    sys.path[:0] = [one for one in path if one not in sys.path]
    if message["module"] and from_here:
        from cgm_jax.config.named import import_gymnasium_module

        import_gymnasium_module(message["name"], message["trust"])
    elif message["module"]:
        importlib.import_module(message["module"])
    return rows.Rows(message["id"])


def runs_on(message: dict[str, Any]) -> dict[str, dict[str, str]]:
    """What results depend on in this process: versions, and SHA-256 of the user's own files."""
    packages = {"gymnasium", "numpy", "mujoco"}
    files: dict[str, str] = {}
    if module := message["module"]:
        providers = getattr(importlib.metadata, "packages_distributions", dict)()  # from 3.10 on
        packages |= {name for name in providers.get(module.partition(".")[0], ()) if name}
        if message["path"] is not None:
            from cgm_jax.config.named import folder_of
            from cgm_jax.config.user_code import run_files

            files = run_files(folder_of(message["name"]))
    versions = {"Python": platform.python_version()}
    for package in sorted(packages):
        with contextlib.suppress(importlib.metadata.PackageNotFoundError):
            versions[package] = importlib.metadata.version(package)
    return {"versions": versions, "files": files}


def own_package() -> Any:
    """This folder as a package by itself, under a name that no module of the user's has.

    By its own name it cannot be imported, since cgm_jax may be missing.
    """
    folder = Path(__file__).parent
    spec = importlib.util.spec_from_file_location("_cgm_jax_hosted", folder / "__init__.py")
    assert spec is not None
    assert spec.loader is not None
    package = sys.modules[spec.name] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(package)
    importlib.import_module(f"{spec.name}.rows")
    return package


def serve(rows: Any, op: str, arrays: "list[np.ndarray]") -> "list[np.ndarray]":
    """The answer to a request."""
    import numpy as np

    if op == "success":
        return [rows.success(*arrays)]
    ticket, batch = rows.reset(*arrays) if op == "reset" else rows.step(*arrays)
    return [
        *batch.observation.values(),
        batch.terminated,
        batch.truncated,
        np.full(len(batch.seeds), ticket, np.uint32),
    ]


if __name__ == "__main__":
    main()
