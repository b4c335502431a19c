"""Checkpoints as files: which of them are finished and whole, and what config they carry.

What the arrays in them mean is known to host/checkpoint.py. No JAX is needed here.
"""

import hashlib
import json
import re
from pathlib import Path
from typing import Any

from cgm_jax.config.fields import SettingError
from cgm_jax.storage.files import replacing
from cgm_jax.storage.untrusted import UNREADABLE, from_json

FORMAT = 3
"""Of checkpoints, in the manifest. Format 1 had no such entry; curriculum `uniform` had no state
before format 3. Arrays of older formats are read if they fit.
"""

NAME = re.compile(r"group[0-9]{1,9}_epoch[0-9]{1,10}_cycle[0-9]{1,10}(_part[0-9]{1,10})?\.npz")
"""Of a checkpoint; what else lies beside them is nobody's business."""


def manifest_path(path: Path) -> Path:
    """Where a checkpoint's SHA-256 and size are written, and the config, last of all."""
    return path.with_suffix(".json")


def write_manifest(path: Path, sha256: str, size: int, config: bytes) -> None:
    """Finish a checkpoint.

    Args:
        path: the checkpoint.
        sha256: of its bytes.
        size: how many they are.
        config: config.json, so that it can be restored.

    Raises:
        OSError: it cannot be written.
    """
    text = config.decode(errors="replace")
    entry = {
        "format": FORMAT,
        "sha256": sha256,
        "bytes": size,
        "config": text,
        "config_sha256": hashlib.sha256(text.encode()).hexdigest(),
    }
    with replacing(manifest_path(path), durable=True) as file:
        file.write(json.dumps(entry).encode())


def finished_checkpoints(directory: Path, group: int | str = "*") -> list[Path]:
    """A group's finished checkpoints, oldest first; or those of all groups."""

    def position(path: Path) -> list[int]:
        return [int(number) for number in re.findall(r"\d+", path.stem)]

    paths = [path for path in directory.glob(f"group{group}_*.npz") if NAME.fullmatch(path.name)]
    return sorted((path for path in paths if manifest_path(path).exists()), key=position)


def position(directory: Path, group: int) -> tuple[int, int]:
    """Whole epochs that a group has done, and whole cycles of the next one.

    (0, 0) without a checkpoint.
    """
    paths = finished_checkpoints(directory, group)
    return position_of(paths[-1])[:2] if paths else (0, 0)


def epochs_begun(directory: Path) -> int:
    """Epochs of the group that has come farthest, the one in progress included."""
    positions = [position_of(path) for path in finished_checkpoints(directory)]
    return max([epoch + ((cycle, part) > (0, 0)) for epoch, cycle, part in positions], default=0)


def position_of(path: Path) -> tuple[int, int, int]:
    """Epochs that are done in a checkpoint, cycles of the next one, and parts of the next cycle."""
    epoch, cycle, *part = (int(number) for number in re.findall(r"\d+", path.stem)[1:])
    return epoch, cycle, part[0] if part else 0


def format_of(path: Path) -> int:
    """The format of a checkpoint that this version reads.

    Raises:
        SettingError: it is of a newer one.
    """
    try:
        number = _manifest(path).get("format", 1)
    except (OSError, *UNREADABLE):
        return FORMAT  # `damage` says what is wrong
    if type(number) is not int:
        return FORMAT
    if number > FORMAT:
        raise SettingError(
            f"resume: {path} is a checkpoint of format {number!s:.20}, of a newer version of "
            f"cgm_jax; this one reads up to format {FORMAT}"
        )
    return number


def damage(path: Path) -> str | None:
    """What is wrong with a checkpoint's bytes; None if they are those that were written."""
    try:
        manifest = _manifest(path)
        expected, size, number = manifest["sha256"], manifest["bytes"], manifest.get("format", 1)
    except (OSError, *UNREADABLE):
        return "its manifest cannot be read"
    if type(number) is not int or not 1 <= number <= FORMAT:
        return f"its format is {number!r:.20}"
    try:
        if path.stat().st_size != size:
            return f"{path.stat().st_size} bytes instead of {size}"
        with path.open("rb") as file:
            digest = hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        return str(error.strerror)
    return None if digest == expected else "its checksum differs"


def restore_config(config: Path, checkpoints: Path) -> str | None:
    """Bring a lost or torn config.json back from a checkpoint that is whole.

    A file that holds an object, whatever is in it, is left alone: somebody may have edited it.

    Args:
        config: the file.
        checkpoints: the directory of checkpoints.

    Returns:
        A line that says what was done; None if there was nothing to be done, or no checkpoint
        to do it from.

    Raises:
        OSError: it cannot be written.
    """
    if _holds_object(config):
        return None
    for path in reversed(finished_checkpoints(checkpoints)):
        content = None if damage(path) else _carried_config(path)
        if content is None:
            continue
        state = "was missing"
        if config.exists():
            aside = config.with_name(config.name + ".damaged")
            config.replace(aside)
            state = f"was damaged and is set aside as {aside}"
        with replacing(config, durable=True) as file:
            file.write(content)
        return f"{config} {state}; restored from {path}"
    return None


def holds_config(checkpoints: Path) -> bool:
    """Whether a lost config.json would be restored from one of these checkpoints."""
    return any(_carried_config(path) for path in finished_checkpoints(checkpoints))


def _manifest(path: Path) -> Any:
    """What the manifest of a checkpoint holds; whatever is wrong with it raises."""
    return from_json(manifest_path(path).read_bytes())


def _holds_object(path: Path) -> bool:
    try:
        return isinstance(from_json(path.read_bytes()), dict)
    except (OSError, *UNREADABLE):
        return False


def _carried_config(path: Path) -> bytes | None:
    """The config beside a checkpoint; None in those of versions that did not write one."""
    try:
        manifest = _manifest(path)
        content = manifest["config"].encode()
        whole = hashlib.sha256(content).hexdigest() == manifest["config_sha256"]
    except (OSError, *UNREADABLE):
        return None
    return content if whole else None
