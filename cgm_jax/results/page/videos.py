"""Videos in run directories, put into the page."""

import base64
import os
import stat
import sys
from collections.abc import Iterator
from html import escape
from pathlib import Path

from cgm_jax.storage.untrusted import printable

KINDS = {".mp4": "video/mp4", ".webm": "video/webm", ".gif": "image/gif"}

MAX_BYTES = 32 * 2**20
"""Of one video; a browser has to keep all of them in memory."""

MAX_VIDEOS = 24


def video_figures(path: Path, label: str) -> str:
    """All videos of a run directory as HTML; of those left out a line on standard error."""
    shown = []
    for file in _videos(path):
        try:
            size = file.stat().st_size
            if size > MAX_BYTES or len(shown) == MAX_VIDEOS:
                reason = f"{size:,} bytes" if size > MAX_BYTES else f"more than {MAX_VIDEOS} videos"
                print(f"{printable(str(file))} is not in the page: {reason}", file=sys.stderr)
                continue
            shown.append(_figure(file, f"{label}/{file.relative_to(path)}"))
        except OSError as error:
            told = f"{printable(str(file))} is not in the page: {error.strerror}"
            print(told, file=sys.stderr)
    return "".join(shown)


def _videos(path: Path) -> Iterator[Path]:
    """Regular files only: a link in a directory from elsewhere leads anywhere, a pipe to no end."""
    for folder, folders, files in os.walk(path):
        folders.sort()
        for name in sorted(files):
            file = Path(folder) / name
            if file.suffix.lower() in KINDS and _is_regular(file):
                yield file


def _is_regular(file: Path) -> bool:
    try:
        return stat.S_ISREG(file.lstat().st_mode)
    except OSError:  # it has gone meanwhile
        return False


def _figure(file: Path, caption: str) -> str:
    kind = KINDS[file.suffix.lower()]
    source = f"data:{kind};base64,{base64.b64encode(file.read_bytes()).decode()}"
    name = escape(caption.encode(errors="replace").decode())
    if kind.startswith("image"):
        shown = f'<img alt="{name}" src="{source}">'
    else:
        told = f'aria-label="{name}" src="{source}"'
        shown = f"<video controls loop muted playsinline {told}></video>"
    return f"<figure>{shown}<figcaption>{name}</figcaption></figure>"
