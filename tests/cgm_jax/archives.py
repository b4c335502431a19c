"""Archives of arrays whose bytes are damaged, under a checksum that says they are whole."""

import hashlib
import json
import struct
import zipfile
from pathlib import Path

from cgm_jax.storage.checkpoints import manifest_path


def spoil(path: Path, name: str | None = None) -> None:
    """Change a byte in the middle of a member, the largest by default, but not its checksum.

    If there is a manifest, it is made to match.
    """
    with zipfile.ZipFile(path) as archive:
        members = {info.filename: info for info in archive.infolist()}
    largest = max(members.values(), key=lambda info: info.file_size)
    member = largest if name is None else members[f"{name}.npy"]
    data = bytearray(path.read_bytes())
    lengths = struct.unpack_from("<HH", data, member.header_offset + 26)
    data[member.header_offset + 30 + sum(lengths) + member.compress_size // 2] ^= 1
    path.write_bytes(data)
    if (manifest := manifest_path(path)).exists():
        entry = json.loads(manifest.read_text()) | {"sha256": hashlib.sha256(data).hexdigest()}
        manifest.write_text(json.dumps(entry))
