"""A page in headless Chromium, and what it complains of."""

import contextlib
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

DESKTOP = {"width": 1280, "height": 900}
PHONE = {"width": 360, "height": 740}


@contextlib.contextmanager
def chromium() -> Iterator[Any]:
    """Debian's Chromium, headless."""
    from playwright.sync_api import sync_playwright  # pyright: ignore[reportMissingImports]

    # Without its sandbox, which does not work for root, and the pages are our own.
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(
            executable_path=shutil.which("chromium"), args=["--no-sandbox"]
        )
        yield browser
        browser.close()


@contextlib.contextmanager
def opened(
    browser: Any,
    page: Path,
    chosen: str = "",
    size: dict[str, int] | None = None,
    dark: bool = False,
) -> Iterator[Any]:
    """A page once it is drawn, in a window of its own; `chosen` is what follows # in its address.

    Raises:
        AssertionError: it wrote to the console, raised something, or asked for another file.
    """
    wrong: list[str] = []
    context = browser.new_context(
        viewport=size or DESKTOP, color_scheme="dark" if dark else "light"
    )
    view = context.new_page()
    view.on("console", lambda message: wrong.append(message.text))
    view.on("pageerror", lambda error: wrong.append(str(error)))
    address = page.absolute().as_uri()
    view.on(
        "request",
        lambda request: (
            None if request.url.startswith((address, "data:")) else wrong.append(request.url)
        ),
    )
    view.goto(f"{address}#{chosen}")
    view.wait_for_selector("body[data-ready]")
    yield view
    context.close()
    assert not wrong, wrong
