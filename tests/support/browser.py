"""A headless Chromium, driven over the DevTools protocol by a pipe. The standard library is all."""

from __future__ import annotations

import base64
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

#: The names under which systems have it.
NAMES = ("chromium", "chromium-browser", "google-chrome-stable", "google-chrome")

#: Puts the ends of both pipes where the browser looks for them, then becomes the browser.
_LAUNCH = """
import fcntl, os, sys
commands, answers, *browser = sys.argv[1:]
# Out of the way first: either may be 3 or 4 itself.
ends = [fcntl.fcntl(int(end), fcntl.F_DUPFD, 10) for end in (commands, answers)]
for place, end in zip((3, 4), ends):
    os.dup2(end, place)
os.execvp(browser[0], browser)
"""

#: Nothing goes out, nothing is asked, and the same is drawn everywhere.
_ARGUMENTS = (
    "--headless=new",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-dev-shm-usage",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-default-apps",
    "--disable-extensions",
    "--disable-sync",
    "--hide-scrollbars",
    "--host-resolver-rules=MAP * ~NOTFOUND",
    "--no-default-browser-check",
    "--no-first-run",
    "--force-color-profile=srgb",
    "--remote-debugging-pipe",
    "about:blank",
)


def chromium() -> str | None:
    """The browser's command; None where there is none."""
    return next(filter(None, map(shutil.which, NAMES)), None)


class Browser:
    """One page of a running browser; `problems` is what it complained about since `open`."""

    def __init__(self, profile: Path) -> None:
        command = chromium()
        assert command is not None
        theirs_in, self._commands = os.pipe()
        self._answers, theirs_out = os.pipe()
        self._process = subprocess.Popen(
            [sys.executable, "-c", _LAUNCH, str(theirs_in), str(theirs_out), command,
             f"--user-data-dir={profile}", *_ARGUMENTS],
            pass_fds=(theirs_in, theirs_out),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            env={**os.environ, "HOME": str(profile), "TZ": "UTC"},
        )  # fmt: skip
        os.close(theirs_in)
        os.close(theirs_out)
        self._read = b""
        self._number = 0
        self._session: str | None = None
        self._events: list[dict[str, Any]] = []
        self.problems: list[str] = []
        target = self._ask("Target.createTarget", url="about:blank")["targetId"]
        self._session = self._ask("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        for domain in ("Page", "Runtime", "Log", "Network"):
            self._ask(f"{domain}.enable")

    def close(self) -> None:
        try:
            self._session = None
            self._ask("Browser.close")
        finally:
            os.close(self._commands)
            os.close(self._answers)
            self._process.wait()

    # --- what a test does ---

    def open(
        self, path: Path, *, width: int = 1280, dark: bool = False, script: bool = True,
        height: int = 900,
    ) -> None:  # fmt: skip
        """Opens a file at that width, and waits until it is all there."""
        self.problems = []
        self._ask(
            "Emulation.setDeviceMetricsOverride",
            width=width, height=height, deviceScaleFactor=1, mobile=False,
        )  # fmt: skip
        self.prefer("dark" if dark else "light")
        self._ask("Emulation.setScriptExecutionDisabled", value=not script)
        self._events = []
        self._ask("Page.navigate", url=path.resolve().as_uri())
        self._wait_for("Page.loadEventFired")

    def prefer(self, scheme: str) -> None:
        """Light or dark."""
        features = [{"name": "prefers-color-scheme", "value": scheme}]
        self._ask("Emulation.setEmulatedMedia", features=features)

    def media(self, name: str) -> None:
        """`screen` or `print`."""
        self._ask("Emulation.setEmulatedMedia", media=name)

    def value(self, expression: str) -> Any:
        """What a JavaScript expression is on the page."""
        found = self._ask("Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True)
        assert "exceptionDetails" not in found, found
        return found["result"].get("value")

    def press(self, key: str) -> None:
        """Presses and releases a key of that name."""
        code = {
            "Tab": 9, "Enter": 13, " ": 32, "PageUp": 33, "PageDown": 34, "End": 35, "Home": 36,
            "ArrowLeft": 37, "ArrowUp": 38, "ArrowRight": 39, "ArrowDown": 40,
        }[key]  # fmt: skip
        text = {"Enter": "\r", " ": " "}.get(key)
        how: dict[str, Any] = {"key": key, "code": "Space" if key == " " else key, "windowsVirtualKeyCode": code}
        self._ask("Input.dispatchKeyEvent", type="keyDown", **how, **({"text": text} if text else {}))
        self._ask("Input.dispatchKeyEvent", type="keyUp", **how)

    def mouse(self, *steps: tuple[str, float, float]) -> None:
        """Steps of the mouse: `mouseMoved`, `mousePressed` or `mouseReleased`, and where."""
        for kind, x, y in steps:
            self._ask("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", buttons=1, clickCount=1)

    def screenshot(self, path: Path, *, whole: bool = True) -> None:
        """A PNG of the page, or of what of it is seen."""
        found = self._ask("Page.captureScreenshot", format="png", captureBeyondViewport=whole)
        path.write_bytes(base64.b64decode(found["data"]))

    def pdf(self) -> bytes:
        """The page as it is printed."""
        return base64.b64decode(self._ask("Page.printToPDF", printBackground=False)["data"])

    # --- the protocol ---

    def _ask(self, method: str, **parameters: Any) -> dict[str, Any]:
        self._number += 1
        message: dict[str, Any] = {"id": self._number, "method": method, "params": parameters}
        if self._session:
            message["sessionId"] = self._session
        data = json.dumps(message).encode() + b"\0"
        while data:
            data = data[os.write(self._commands, data) :]
        while True:
            answer = self._next()
            if answer.get("id") == self._number:
                assert "error" not in answer, (method, answer["error"])
                result: dict[str, Any] = answer["result"]
                return result

    def _wait_for(self, event: str) -> None:
        while not any(seen["method"] == event for seen in self._events):
            self._next()

    def _next(self) -> dict[str, Any]:
        while b"\0" not in self._read:
            more = os.read(self._answers, 1 << 20)
            assert more, "the browser has ended"
            self._read += more
        line, _, self._read = self._read.partition(b"\0")
        message: dict[str, Any] = json.loads(line)
        if "method" in message:
            self._events.append(message)
            self._note(message["method"], message["params"])
        return message

    def _note(self, event: str, what: dict[str, Any]) -> None:
        if event == "Runtime.exceptionThrown":
            self.problems.append(what["exceptionDetails"]["text"])
        elif event == "Runtime.consoleAPICalled" and what["type"] in ("error", "warning", "assert"):
            self.problems.append(str(what["args"]))
        elif event == "Log.entryAdded" and what["entry"]["level"] in ("error", "warning"):
            self.problems.append(what["entry"]["text"])
        elif event == "Network.requestWillBeSent":
            url = what["request"]["url"]
            if not url.startswith(("file:", "data:")):
                self.problems.append(f"asked for {url}")
