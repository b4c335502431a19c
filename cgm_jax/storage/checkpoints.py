"""Checkpoints as files: which of them are finished and whole, and what config they carry.

What the arrays in them mean is known to host/checkpoint.py. No JAX is needed here.

Damage is what is wrong with bytes. That the system does not hand them out just now, as a network
disk that is away, says nothing of them: it is a `ReadError`, and all stays where it is.
"""

import contextlib
import hashlib
import json
import re
from pathlib import Path
from typing import Any

from cgm_jax.config.fields import SettingError
from cgm_jax.storage.files import ABSENT, reading, replacing
from cgm_jax.storage.untrusted import MAX_CONFIG_BYTES, UNREADABLE, from_json, read_json

FORMAT = 4
"""Of checkpoints, in the manifest. Format 1 had no such entry; curriculum `uniform` had no state
before format 3; before format 4 masks that `cgm` measures were counted in rounds of all. Arrays of
older formats are read if they fit.
"""

NAME = re.compile(r"group[0-9]{1,9}_epoch[0-9]{1,10}_cycle[0-9]{1,10}(_part[0-9]{1,10})?\.npz")
"""Of a checkpoint; what else lies beside them is nobody's business."""

MAX_MANIFEST_BYTES = 2 * MAX_CONFIG_BYTES
"""It has the config as a text, whose quotation marks and ends of lines are two letters each."""


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
    _write_manifest(path, {"format": FORMAT, "sha256": sha256, "bytes": size}, config)


def write_manifest_again(source: Path, path: Path, config: bytes) -> None:
    """Finish a copy of a checkpoint, which may be of an older format, with another config.

    Raises:
        ReadError: the manifest of the source cannot be read.
        OSError: it cannot be written.
    """
    _write_manifest(path, _manifest(source), config)


def _write_manifest(path: Path, facts: dict[str, Any], config: bytes) -> None:
    text = config.decode(errors="replace")
    digest = hashlib.sha256(text.encode()).hexdigest()
    entry = {**facts, "config": text, "config_sha256": digest}
    with replacing(manifest_path(path), durable=True) as file:
        file.write(json.dumps(entry).encode())


def finished_checkpoints(directory: Path, group: int | str = "*") -> list[Path]:
    """A group's finished checkpoints, oldest first; or those of all groups.

    Raises:
        ReadError: the directory cannot be read, though it is there.
    """

    def position(path: Path) -> list[int]:
        return [int(number) for number in re.findall(r"\d+", path.stem)]

    try:
        with reading(directory):  # which glob would pass over, as if there were no checkpoints
            there = set(directory.iterdir())
    except ABSENT:
        return []
    paths = [path for path in there if NAME.fullmatch(path.name) and manifest_path(path) in there]
    if group != "*":
        paths = [path for path in paths if path.name.startswith(f"group{group}_")]
    return sorted(paths, key=position)


def last_whole(directory: Path, group: int) -> tuple[Path | None, dict[Path, str]]:
    """The group's latest checkpoint that is whole, None if there is none.

    Returns:
        It, and what is wrong with each later one, the latest first.

    Raises:
        SettingError: one of these is of a newer format.
        ReadError: one cannot be read just now, or as `finished_checkpoints`.
    """
    damaged: dict[Path, str] = {}
    for path in reversed(finished_checkpoints(directory, group)):
        format_of(path)  # a newer one looks damaged
        complaint = damage(path)
        if complaint is None:
            return path, damaged
        damaged[path] = complaint
    return None, damaged


def epochs_begun(directory: Path) -> int:
    """Epochs of the group that has come farthest, the one in progress included.

    Raises:
        ReadError: as `finished_checkpoints`.
    """
    positions = [position_of(path) for path in finished_checkpoints(directory)]
    return max([epoch + ((cycle, part) > (0, 0)) for epoch, cycle, part in positions], default=0)


def epochs_done(directory: Path) -> dict[int, int]:
    """Whole epochs in each group's last checkpoint, by the group's number, as their names say.

    Raises:
        ReadError: as `finished_checkpoints`.
    """
    paths = finished_checkpoints(directory)  # the last one of a group comes last
    return {int(re.findall(r"\d+", path.stem)[0]): position_of(path)[0] for path in paths}


def position_of(path: Path) -> tuple[int, int, int]:
    """Epochs that are done in a checkpoint, cycles of the next one, and parts of the next cycle."""
    epoch, cycle, *part = (int(number) for number in re.findall(r"\d+", path.stem)[1:])
    return epoch, cycle, part[0] if part else 0


def format_of(path: Path) -> int:
    """The format of a checkpoint that this version reads.

    Raises:
        SettingError: it is of a newer one.
        ReadError: its manifest cannot be read just now.
    """
    try:
        number = _manifest(path).get("format", 1)
    except (*ABSENT, *UNREADABLE):
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
    """What is wrong with a checkpoint's bytes; None if they are those that were written.

    Raises:
        ReadError: they cannot be read just now.
    """
    try:
        manifest = _manifest(path)
        expected, size, number = manifest["sha256"], manifest["bytes"], manifest.get("format", 1)
    except (*ABSENT, *UNREADABLE):
        return "its manifest cannot be read"
    if type(number) is not int or not 1 <= number <= FORMAT:
        return f"its format is {number!r:.20}"
    try:
        with reading(path):
            if (found := path.stat().st_size) != size:
                return f"{found} bytes instead of {size}"
            with path.open("rb") as file:
                digest = hashlib.file_digest(file, "sha256").hexdigest()
    except ABSENT as error:
        return str(error.strerror)
    return None if digest == expected else "its checksum differs"


def restore_config(config: Path, checkpoints: Path) -> str | None:
    """Bring a lost or torn config.json back from a checkpoint that is whole.

    Of several configs the one that knows of most resumptions, since a checkpoint has the config of
    when its group was last trained. A file that holds an object, whatever is in it, is left alone:
    somebody may have edited it.

    Args:
        config: the file.
        checkpoints: the directory of checkpoints.

    Returns:
        A line that says what was done; None if there was nothing to be done, or no checkpoint
        to do it from.

    Raises:
        ReadError: it, or a checkpoint, cannot be read just now.
        OSError: it cannot be written.
    """
    if _holds_object(config):
        return None
    for path, content in _carried_configs(checkpoints):
        if damage(path):
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
    with contextlib.suppress(OSError):
        return bool(_carried_configs(checkpoints))
    return False


def _manifest(path: Path) -> Any:
    """What the manifest of a checkpoint holds; whatever is wrong with it raises."""
    manifest = manifest_path(path)
    with reading(manifest):
        return read_json(manifest, MAX_MANIFEST_BYTES)


def _holds_object(path: Path) -> bool:
    """Whether a file holds an object of JSON, and is no larger than a config.

    Raises:
        ReadError: it cannot be read just now.
    """
    try:
        with reading(path):
            return isinstance(read_json(path, MAX_CONFIG_BYTES), dict)
    except (*ABSENT, *UNREADABLE):
        return False


def _carried_configs(checkpoints: Path) -> list[tuple[Path, bytes]]:
    """Configs that may come back, each with its checkpoint, the latest first.

    A merge writes its config beside the checkpoints of all groups, last of all: where one of these
    is missing it was killed, and what is there is no sweep.

    Raises:
        ReadError: a checkpoint cannot be read just now, or as `finished_checkpoints`.
    """
    paths = finished_checkpoints(checkpoints)
    groups = {path.name.partition("_")[0] for path in paths}
    found: list[tuple[int, Path, bytes]] = []
    for path in reversed(paths):
        content = _carried_config(path)
        with contextlib.suppress(*UNREADABLE):
            config = from_json(content or b"")
            if "parts" not in config or len(groups) >= len(config["groups"]):
                found.append((len(config.get("resumed", ())), path, content or b""))
    found.sort(key=lambda entry: entry[0], reverse=True)  # stable: else the last checkpoint's
    return [(path, content) for _, path, content in found]


def _carried_config(path: Path) -> bytes | None:
    """The config beside a checkpoint; None in those of versions that did not write one.

    Raises:
        ReadError: it cannot be read just now.
    """
    try:
        manifest = _manifest(path)
        content = manifest["config"].encode()
        whole = hashlib.sha256(content).hexdigest() == manifest["config_sha256"]
    except (*ABSENT, *UNREADABLE):
        return None
    return content if whole else None
