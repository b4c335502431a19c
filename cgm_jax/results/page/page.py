"""The page as one file: page.html with its style, its programs and the data put in."""

import base64
import gzip
import json
from collections.abc import Sequence
from html import escape
from pathlib import Path
from string import Template
from typing import Any

from cgm_jax.results.page.data import page_data
from cgm_jax.results.page.sweeps import Sweep
from cgm_jax.results.page.videos import video_figures
from cgm_jax.storage.files import remove_abandoned, replacing

FOLDER = Path(__file__).parent
LIBRARIES = ("vendor/d3.min.js", "vendor/plot.umd.min.js")
LICENCES = ("vendor/LICENSE-d3", "vendor/LICENSE-plot", "vendor/LICENSE-bundled")
PROGRAMS = (
    *("statistics", "choices", "labels", "palette", "elements", "charts"),
    *("overview", "curve_chart", "curves", "level_charts", "levels"),
    *("final", "masks", "measures", "page"),
)
"""Files of js/, in the order in which they are put together."""


def write_page(path: Path, sweeps: Sequence[Sweep], reload_seconds: float | None = None) -> None:
    """Write the page, whole or not at all.

    Args:
        path: the file.
        sweeps: what it shows.
        reload_seconds: how often the page is to look for a newer one; None if there will be none.

    Raises:
        OSError: it cannot be written.
    """
    text = page_text(sweeps, reload_seconds).encode()
    remove_abandoned(path)
    with replacing(path) as file:
        file.write(text)


def page_text(sweeps: Sequence[Sweep], reload_seconds: float | None = None) -> str:
    """The page as HTML that loads nothing from anywhere."""
    data = page_data(sweeps)
    data["reload"] = reload_seconds
    labels = [sweep["label"] for sweep in data["sweeps"]]
    videos = "".join(
        video_figures(sweep.path, label) for sweep, label in zip(sweeps, labels, strict=True)
    )
    return Template(_read("page.html")).substitute(
        title=escape(", ".join(labels).encode(errors="replace").decode()),
        style=_read("page.css"),
        licences="\n\n".join(map(_read, LICENCES)),
        libraries="\n".join(f"<script>{_read(name)}</script>" for name in LIBRARIES),
        program="\n".join(_read(f"js/{name}.js") for name in PROGRAMS),
        data=packed(data),
        videos=videos,
    )


def packed(data: Any) -> str:
    """Data as base64 of compressed JSON: a third of the size, and no text of it is taken for HTML.

    The same data give the same text.
    """
    text = json.dumps(data, allow_nan=False, separators=(",", ":"))
    return base64.b64encode(gzip.compress(text.encode(), compresslevel=6, mtime=0)).decode()


def unpacked(page: str) -> Any:
    """The data of a page."""
    text = page.partition('<script id="data" type="text/plain">')[2].partition("</script>")[0]
    return json.loads(gzip.decompress(base64.b64decode(text)))


def _read(name: str) -> str:
    return (FOLDER / name).read_text(encoding="utf-8")
