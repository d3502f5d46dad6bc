"""A headless Chromium that is driven by its DevTools protocol: for screenshots of the viewer, and for tests."""

from __future__ import annotations

import base64
import json
import os
import re
import shutil
import subprocess
import tempfile
import threading
import time
import urllib.request
from pathlib import Path
from typing import Any

from websockets.sync.client import connect

from golden.scenes.files import atomic_output
from spec.errors import InputError

PLACES = ("/usr/bin/chromium", "/usr/bin/chromium-browser", "/usr/bin/google-chrome")
"""Where the browser may be; the first is that of the Debian package."""

INSTALL = "apt-get install chromium"

FLAGS = ("--headless=new", "--no-sandbox", "--no-first-run", "--disable-dev-shm-usage", "--use-gl=angle",
         "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--remote-debugging-port=0", "--hide-scrollbars")
"""Pictures are drawn in software, so that no graphics card is needed."""

OWN_WORDS = ("THREE.Clock: This module has been deprecated", "GPU stall due to ReadPixels", "Automatic fallback to software")
"""Warnings that viser's page and software graphics give on every page, whatever is shown."""


def find_chromium() -> Path | None:
    """The browser's program, or None."""
    return next((Path(place) for place in PLACES if os.access(place, os.X_OK)), None)


class Browser:
    """One page of a headless Chromium. Use as a context manager.

    Args:
        size: width and height of the page in pixels.

    Raises:
        InputError: there is no Chromium.
    """

    def __init__(self, size: tuple[int, int] = (1280, 720)) -> None:
        program = find_chromium()
        if program is None:
            raise InputError(f"no Chromium was found in {', '.join(PLACES)}: {INSTALL}")
        self._profile = tempfile.mkdtemp(prefix="msv2-chromium-")
        self._number, self._events = 0, list[dict[str, Any]]()
        self._process = subprocess.Popen(
            [str(program), *FLAGS, f"--user-data-dir={self._profile}", "about:blank"],
            stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
        try:
            self._socket = connect(self._page(), max_size=None)
            for domain in ("Runtime", "Log", "Page"):
                self.call(f"{domain}.enable")
            self.call("Emulation.setDeviceMetricsOverride", width=size[0], height=size[1], deviceScaleFactor=1, mobile=False)
        except BaseException:
            self.close()
            raise

    def _page(self) -> str:
        """The address of the page's DevTools socket."""
        for line in self._process.stderr:
            if found := re.search(r"DevTools listening on ws://([\d.:]+)/", line):
                break
        else:
            raise RuntimeError(f"Chromium must start, but it ended with {self._process.wait()}")
        threading.Thread(target=self._process.stderr.read, daemon=True).start()  # so that it never waits for a reader
        with urllib.request.urlopen(f"http://{found[1]}/json/list", timeout=30) as answer:
            return next(page["webSocketDebuggerUrl"] for page in json.load(answer) if page["type"] == "page")

    def __enter__(self) -> Browser:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def call(self, method: str, **parameters: object) -> dict[str, Any]:
        """Calls a method of the DevTools protocol and returns its result. Raises RuntimeError where the browser refuses."""
        self._number += 1
        self._socket.send(json.dumps({"id": self._number, "method": method, "params": parameters}))
        while True:
            answer = json.loads(self._socket.recv(timeout=60))
            if answer.get("id") == self._number:
                if "error" in answer:
                    raise RuntimeError(f"{method} must succeed, but: {answer['error']['message']}")
                return answer["result"]
            self._events.append(answer)

    def open(self, url: str) -> None:
        """Goes to a page."""
        self.call("Page.navigate", url=url)

    def evaluate(self, expression: str) -> Any:
        """The value of a JavaScript expression in the page."""
        return self.call("Runtime.evaluate", expression=expression, returnByValue=True)["result"].get("value")

    def screenshot(self) -> bytes:
        """The page as PNG."""
        return base64.b64decode(self.call("Page.captureScreenshot")["data"])

    def save_screenshot(self, path: Path) -> Path:
        """Writes the page as PNG."""
        with atomic_output(path) as file:
            file.write(self.screenshot())
        return path

    def _mouse(self, kind: str, x: float, y: float, **more: object) -> None:
        self.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, **more)

    def click(self, x: float, y: float, *, shift: bool = False) -> None:
        """Clicks with the left button, with or without the Shift key."""
        keys = {"modifiers": 8} if shift else {}
        self._mouse("mouseMoved", x, y, **keys)
        for kind in ("mousePressed", "mouseReleased"):
            self._mouse(kind, x, y, button="left", clickCount=1, **keys)

    def drag(self, begin: tuple[float, float], end: tuple[float, float], steps: int = 8) -> None:
        """Drags with the left button."""
        self._mouse("mousePressed", *begin, button="left", buttons=1, clickCount=1)
        for step in range(1, steps + 1):
            place = (a + (b - a) * step / steps for a, b in zip(begin, end, strict=True))
            self._mouse("mouseMoved", *place, button="left", buttons=1)
            time.sleep(0.03)
        self._mouse("mouseReleased", *end, button="left", clickCount=1)

    def complaints(self) -> list[str]:
        """Errors and warnings in the page's console and uncaught exceptions, but for OWN_WORDS."""
        self.evaluate("0")  # takes in what has come meanwhile
        found = []
        for event in self._events:
            kind, what = event.get("method"), event.get("params", {})
            if kind == "Runtime.exceptionThrown":
                found.append(str(what["exceptionDetails"].get("exception", {}).get("description", what)))
            elif kind == "Runtime.consoleAPICalled" and what["type"] in ("error", "warning", "assert"):
                found.append(" ".join(str(arg.get("value", arg.get("description"))) for arg in what["args"]))
            elif kind == "Log.entryAdded" and what["entry"]["level"] in ("error", "warning"):
                found.append(what["entry"]["text"])
        return [words for words in found if not any(own in words for own in OWN_WORDS)]

    def close(self) -> None:
        """Ends the browser and deletes its profile."""
        if hasattr(self, "_socket"):
            self._socket.close()
        self._process.terminate()
        try:
            self._process.wait(10)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        shutil.rmtree(self._profile, ignore_errors=True)
