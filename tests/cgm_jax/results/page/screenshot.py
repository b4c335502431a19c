"""The README's picture of a page, from a sweep on record: `make screenshot`."""

import contextlib
import io
import sys
import tempfile
from pathlib import Path

from PIL import Image

from cgm_jax.results.page.page import write_page
from cgm_jax.results.page.sweeps import read_sweep
from experiments.learning.records import restore
from tests.cgm_jax.results.page.browser import chromium, opened

SWEEP = "quick"
WINDOW = {"width": 1200, "height": 1330}
COLOURS = 96
"""Of the picture's palette, which keeps it small."""


def main(out: Path) -> None:
    """Write the top of the page of a sweep as PNG."""
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
        path, page = Path("runs") / SWEEP, Path("page.html")
        restore(SWEEP, path)
        write_page(page, [read_sweep(path)])
        with chromium() as browser, opened(browser, page, size=WINDOW) as view:
            picture = Image.open(io.BytesIO(view.screenshot()))
    picture.convert("RGB").quantize(COLOURS, dither=Image.Dither.NONE).save(out, optimize=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]).absolute())
