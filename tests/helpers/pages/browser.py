"""A headless Chromium for tests of pages, driven through the DevTools protocol over a pipe: nothing else is needed."""

from __future__ import annotations

import atexit
import base64
import itertools
import json
import os
import shutil
import subprocess
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any

import pytest

__all__ = ["Page", "chromium", "open_browser"]

#: Names of the browser, Debian's first.
_NAMES = ("chromium", "chromium-browser", "google-chrome", "chrome")

#: So long one answer may take, s.
_PATIENCE_S = 60.0


def chromium() -> str:
    """Path of the browser; skips the test where there is none."""
    match = next((path for name in _NAMES if (path := shutil.which(name))), None)
    if match is None:
        pytest.skip("no headless browser: apt install chromium")
    return match


class PageLeft(AssertionError):
    """A page that was left while it computed an answer."""


class Page:
    """One page. errors : what went wrong in it, as written on its console; a test holds this to be empty."""

    def __init__(self, writing: int, reading: int, opener: Page | None = None, context: str | None = None) -> None:
        self._writing, self._reading, self.errors = writing, reading, []
        self._numbers = itertools.count(1) if opener is None else opener._numbers
        self._unread = bytearray() if opener is None else opener._unread
        #: Pages of the browser by their sessions: events of one may be read by another.
        self._tabs: dict[str, Page] = {} if opener is None else opener._tabs
        #: Questions that pages asked; each is answered with yes.
        self.questions: list[str] = []
        #: Profile that the page shares with its tabs: storage, cookies, a window; None for the browser's first.
        self._context = context
        profile = {} if context is None else {"browserContextId": context}
        target = self._call("Target.createTarget", url="about:blank", **profile)["targetId"]
        self._session = self._call("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        self._tabs[self._session] = self
        for domain in ("Page", "Runtime", "Log", "Network"):
            self.call(f"{domain}.enable")

    def tab(self) -> Page:
        """Another page of the same browser."""
        return Page(self._writing, self._reading, self, self._context)

    @contextmanager
    def apart(self) -> Iterator[Page]:
        """A page of the same browser in a profile that ends with the block."""
        context = self._call("Target.createBrowserContext")["browserContextId"]
        try:
            yield Page(self._writing, self._reading, self, context)
        finally:
            self._call("Target.disposeBrowserContext", browserContextId=context)

    def _call(self, method: str, session: str | None = None, **parameters: Any) -> dict[str, Any]:
        number = next(self._numbers)
        message = {"id": number, "method": method, "params": parameters}
        if session:
            message["sessionId"] = session
        os.write(self._writing, json.dumps(message).encode() + b"\0")
        end = time.monotonic() + _PATIENCE_S
        while time.monotonic() < end:
            answer = self._message()
            if answer.get("id") == number:
                if "navigated" in answer.get("error", {}).get("message", ""):
                    raise PageLeft(method)
                if "error" in answer:
                    raise AssertionError(f"{method}: {answer['error']}")
                return answer["result"]
            self._tabs.get(answer.get("sessionId", ""), self)._heard(answer)
        raise AssertionError(f"{method}: no answer")

    def _message(self) -> dict[str, Any]:
        while (end := self._unread.find(b"\0")) < 0:
            more = os.read(self._reading, 1 << 20)
            if not more:
                raise AssertionError("the browser has gone")
            self._unread += more
        message = bytes(self._unread[:end])
        del self._unread[: end + 1]
        return json.loads(message)

    def _heard(self, event: dict[str, Any]) -> None:
        method, parameters = event.get("method"), event.get("params", {})
        if method == "Runtime.exceptionThrown":
            details = parameters["exceptionDetails"]
            self.errors.append(details.get("exception", {}).get("description", details["text"]))
        elif method == "Runtime.consoleAPICalled" and parameters["type"] in ("error", "warning", "assert"):
            self.errors.append(" ".join(str(a.get("value", a.get("description"))) for a in parameters["args"]))
        elif method == "Page.javascriptDialogOpening":
            self.questions.append(parameters["type"])
            yes = {"id": next(self._numbers), "method": "Page.handleJavaScriptDialog", "params": {"accept": True}}
            os.write(self._writing, json.dumps({**yes, "sessionId": event["sessionId"]}).encode() + b"\0")
        elif method == "Log.entryAdded" and parameters["entry"]["level"] in ("error", "warning"):
            self.errors.append(parameters["entry"]["text"])

    def call(self, method: str, **parameters: Any) -> dict[str, Any]:
        """One method of the DevTools protocol on this page."""
        return self._call(method, self._session, **parameters)

    def open(self, address: str | Path, width: int = 1280, height: int = 900, dark: bool = False) -> None:
        """Load a file or an address at a size in CSS pixels, and wait until it is complete."""
        self.size(width, height)
        scheme = {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}
        self.call("Emulation.setEmulatedMedia", features=[scheme])
        where = address.resolve().as_uri() if isinstance(address, Path) else address
        self._load("Page.navigate", url=where)

    def reload(self) -> None:
        """Load the page again, and wait until it is complete."""
        self._load("Page.reload")

    def _load(self, method: str, **parameters: Any) -> None:
        self.run("window.isOld = true")  # the old page may still answer for a while
        self.call(method, **parameters)
        self.until("!window.isOld && document.readyState === 'complete'")

    def size(self, width: int, height: int = 900) -> None:
        """Change the size of the window."""
        self.call(
            "Emulation.setDeviceMetricsOverride",
            width=width,
            height=height,
            deviceScaleFactor=1,
            mobile=False,
        )

    def run(self, expression: str) -> Any:
        """The value of a JavaScript expression; promises are waited for."""
        answer = self.call("Runtime.evaluate", expression=expression, awaitPromise=True, returnByValue=True)
        if "exceptionDetails" in answer:
            details = answer["exceptionDetails"]
            raise AssertionError(details.get("exception", {}).get("description", details["text"]))
        return answer["result"].get("value")

    def until(self, condition: str) -> None:
        """Wait until an expression is true, in this page or in the one that follows."""
        end = time.monotonic() + _PATIENCE_S
        while not self._holds(condition):
            if time.monotonic() > end:
                raise AssertionError(f"never true: {condition}")
            time.sleep(0.02)

    def _holds(self, condition: str) -> bool:
        try:
            return bool(self.run(condition))
        except PageLeft:
            return False

    def click(self, x: float, y: float) -> None:
        """A click of the main button at a point of the window, CSS pixels."""
        self.drag((x, y), (x, y))

    def drag(self, start: tuple[float, float], end: tuple[float, float]) -> None:
        """Press at one point, move to another, release."""
        event = {"button": "left", "clickCount": 1}
        for kind, (x, y) in (("mousePressed", start), ("mouseMoved", end), ("mouseReleased", end)):
            self.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, buttons=1, **event)

    def key(self, key: str, shift: bool = False) -> None:
        """Press and release a key, by its name in JavaScript."""
        arrows = {"ArrowLeft": 37, "ArrowUp": 38, "ArrowRight": 39, "ArrowDown": 40}
        code = {**arrows, "Escape": 27, "Tab": 9, "Enter": 13}.get(key, ord(key.upper()[0]))
        text = {"text": "\r" if key == "Enter" else key} if len(key) == 1 or key == "Enter" else {}
        event = {"key": key, "windowsVirtualKeyCode": code, "modifiers": 8 if shift else 0}
        self.call("Input.dispatchKeyEvent", type="keyDown", **event, **text)
        self.call("Input.dispatchKeyEvent", type="keyUp", **event)

    def screenshot(self, path: Path, full_page: bool = True) -> None:
        """Write a PNG of the whole page, or of the window."""
        data = self.call("Page.captureScreenshot", captureBeyondViewport=full_page)["data"]
        path.write_bytes(base64.b64decode(data))

    def pdf(self) -> bytes:
        """The page as printed."""
        return base64.b64decode(self.call("Page.printToPDF", preferCSSPageSize=True)["data"])


@contextmanager
def open_browser() -> Iterator[Page]:
    """A page in a new profile, which ends with the block. All tests of a process share one browser."""
    with _started().apart() as page:
        yield page


@cache
def _started() -> Page:
    """The browser, by its first page; it ends with this process, and its files are removed."""
    program = chromium()
    here_in, there_out = os.pipe()
    there_in, here_out = os.pipe()
    profile = tempfile.TemporaryDirectory(ignore_cleanup_errors=True)
    command = [
        program,
        "--headless=new",
        "--no-sandbox",
        "--disable-gpu",
        "--disable-dev-shm-usage",
        "--no-first-run",
        "--disable-background-networking",
        "--disable-component-update",
        "--hide-scrollbars",
        f"--user-data-dir={profile.name}",
        "--remote-debugging-pipe",
    ]
    # the browser reads the protocol from descriptor 3 and writes it to 4
    joined = ["bash", "-c", f'exec "$@" 3<&{there_in} 4>&{there_out}', "bash", *command]
    process = subprocess.Popen(
        joined, pass_fds=(there_in, there_out), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    os.close(there_in)
    os.close(there_out)

    @atexit.register
    def end() -> None:
        os.close(here_out)
        os.close(here_in)
        try:
            process.wait(10)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
        profile.cleanup()

    return Page(here_out, here_in)
