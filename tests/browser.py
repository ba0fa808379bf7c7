"""Pages in a browser, for tests; the fixture ``browser`` skips them with the reason where there is none."""

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

_NAMES = ("chromium", "chromium-browser", "google-chrome")
_OPTIONS = ("--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader")


class Opened:
    """A page in a browser, with all that it asked of a network and all that it said on the console."""

    def __init__(self, page: Any) -> None:
        self.page = page
        self.requests = list[str]()
        self.messages = list[str]()
        page.on("request", lambda request: self.requests.append(request.url))
        page.on("console", lambda message: self.messages.append(message.text))
        page.on("pageerror", lambda error: self.messages.append(str(error)))

    def value(self, expression: str) -> Any:
        """Value of a JavaScript expression."""
        return self.page.evaluate(expression)


@contextmanager
def running_browser() -> Iterator[Any]:
    """Start Chromium, or the browser that ``OFFTRACK_BROWSER`` names."""
    playwright = pytest.importorskip("playwright.sync_api", reason="the package playwright is not installed")
    program = os.environ.get("OFFTRACK_BROWSER") or next(filter(None, map(shutil.which, _NAMES)), None)
    if program is None:
        pytest.skip("no Chromium here: install chromium, or name a browser by OFFTRACK_BROWSER")
    with playwright.sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=program, args=list(_OPTIONS))
        try:
            yield browser
        finally:
            browser.close()


@contextmanager
def opened_page(
    browser: Any, path: Path, *, width: int = 1400, height: int = 1200, link: str = "", scheme: str = "light"
) -> Iterator[Opened]:
    """Open a file, with the end ``link`` of its address, and wait until its playback is ready."""
    page = browser.new_page(viewport={"width": width, "height": height}, color_scheme=scheme)
    try:
        opened = Opened(page)
        page.goto(path.resolve().as_uri() + link)
        page.wait_for_selector("#player[data-ready]", state="attached", timeout=20_000)
        yield opened
    finally:
        page.close()
