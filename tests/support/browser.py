"""A headless Chromium, the system's own, driven by Playwright, which brings none of its own here."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

from playwright.sync_api import ConsoleMessage, Page, Request, sync_playwright

#: The names under which systems have it.
NAMES = ("chromium", "chromium-browser", "google-chrome-stable", "google-chrome")

#: Nothing goes out.
_ARGUMENTS = ("--disable-gpu", "--host-resolver-rules=MAP * ~NOTFOUND")


def chromium() -> str | None:
    """The browser's command; None where there is none."""
    return next(filter(None, map(shutil.which, NAMES)), None)


class Browser:
    """A running browser; `page`: what it shows; `problems`: its complaints since `open`."""

    def __init__(self) -> None:
        self._driver = sync_playwright().start()
        self._browser = self._driver.chromium.launch(
            executable_path=chromium(), args=_ARGUMENTS, chromium_sandbox=False
        )
        self.problems: list[str] = []
        # Whether scripts run is settled when a page is made.
        self._pages = {script: self._new_page(script) for script in (True, False)}
        self.page = self._pages[True]

    def _new_page(self, script: bool) -> Page:
        page = self._browser.new_page(java_script_enabled=script, timezone_id="UTC")
        page.on("console", self._note_message)
        page.on("pageerror", lambda error: self.problems.append(str(error)))
        page.on("request", self._note_request)
        return page

    def _note_message(self, message: ConsoleMessage) -> None:
        if message.type in ("assert", "error", "warning"):
            self.problems.append(message.text)

    def _note_request(self, request: Request) -> None:
        if not request.url.startswith(("file:", "data:")):
            self.problems.append(f"asked for {request.url}")

    def close(self) -> None:
        self._browser.close()
        self._driver.stop()

    def open(
        self, path: Path, *, width: int = 1280, dark: bool = False, script: bool = True
    ) -> None:
        """Opens a file at that width, and waits until it is all there."""
        self.page = self._pages[script]
        self.problems.clear()
        self.page.set_viewport_size({"width": width, "height": 900})
        self.page.emulate_media(color_scheme="dark" if dark else "light")
        self.page.goto(path.resolve().as_uri())

    def value(self, expression: str) -> Any:
        """What a JavaScript expression is on the page."""
        return self.page.evaluate(expression)
