"""A headless Chromium: it opens pages, is used by mouse, takes screenshots, and repeats what the console said.

Chromium is driven by its DevTools protocol through its debugging pipe, so that no package is needed, and so that it ends when
this process ends in whatever way. Its command line alone does not serve, because a window of it is at least 500 pixels wide.
"""

from __future__ import annotations

import base64
import fcntl
import json
import os
import select
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any

from spec.errors import InputError

NAMES = ("chromium", "chromium-browser", "google-chrome")
HINT = "apt-get install chromium"
FLAGS = ("--headless=new", "--remote-debugging-pipe", "--hide-scrollbars", "--no-first-run", "--disable-dev-shm-usage",
         "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader")
"""Pictures are drawn in software, so that no graphics card is needed."""

OWN_WORDS = ("GPU stall due to ReadPixels", "Automatic fallback to software")
"""Warnings of drawing in software, whatever is shown."""

ENDED = f"Chromium ended early; is it the browser of `{HINT}`?"

_START = "import os, sys; os.dup2(int(sys.argv[1]), 3); os.dup2(int(sys.argv[2]), 4); os.execv(sys.argv[3], sys.argv[3:])"
"""Becomes Chromium, which reads from file 3 and writes to file 4."""

SECONDS = 60
"""How long Chromium may take for an answer."""


def find_chromium() -> str | None:
    """The path of Chromium; None where it is not installed."""
    return next((path for path in map(shutil.which, NAMES) if path), None)


class Browser:
    """A page in a headless browser."""

    def __init__(self, to_browser: int, from_browser: int) -> None:
        self._out, self._in, self._number, self._rest = to_browser, from_browser, 0, b""
        self._events: list[dict[str, Any]] = []
        target = self.ask("Target.createTarget", {"url": "about:blank"}, session=None)["targetId"]
        self._session = self.ask("Target.attachToTarget", {"targetId": target, "flatten": True}, session=None)["sessionId"]
        for domain in ("Page", "Runtime", "Log"):
            self.ask(f"{domain}.enable")

    _session: str | None = None

    def _message(self) -> dict[str, Any]:
        while b"\0" not in self._rest:
            if not select.select([self._in], [], [], SECONDS)[0]:
                raise InputError(f"Chromium gave no answer within {SECONDS} seconds")
            more = os.read(self._in, 1 << 20)
            if not more:
                raise InputError(ENDED)
            self._rest += more
        text, self._rest = self._rest.split(b"\0", 1)
        return json.loads(text)

    def ask(self, method: str, parameters: Mapping[str, object] | None = None, session: str | None = "") -> dict[str, Any]:
        """The result of a command of the DevTools protocol.

        Raises:
            InputError: Chromium ended, gave no answer, or refused the command.
        """
        self._number += 1
        made: dict[str, object] = {"id": self._number, "method": method, "params": dict(parameters or {})}
        if session is not None:
            made["sessionId"] = session or self._session
        try:
            os.write(self._out, json.dumps(made).encode() + b"\0")
        except BrokenPipeError as error:
            raise InputError(ENDED) from error
        while (answer := self._message()).get("id") != self._number:
            self._events.append(answer)
        if "error" in answer:
            raise InputError(f"Chromium refused {method}: {answer['error']['message']}")
        return answer["result"]

    def open(self, url: str, width: int, height: int) -> None:
        """Opens a page in a window of this size, and waits until it is loaded."""
        self.ask("Emulation.setDeviceMetricsOverride",
                 {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": False})
        self._events.clear()
        self.ask("Page.navigate", {"url": url})
        self.wait(lambda: any(event.get("method") == "Page.loadEventFired" for event in self._events))

    def wait(self, done: Callable[[], bool]) -> None:
        """Reads events until the condition holds."""
        end = time.monotonic() + SECONDS
        while not done():
            if time.monotonic() > end:
                raise InputError(f"Chromium did not load a page within {SECONDS} seconds")
            self._events.append(self._message())

    def run(self, script: str) -> Any:
        """The value of an expression in JavaScript, evaluated on the page."""
        answer = self.ask("Runtime.evaluate", {"expression": script, "returnByValue": True, "awaitPromise": True})
        if "exceptionDetails" in answer:
            raise InputError(f"the page's script failed: {answer['exceptionDetails']['text']}")
        return answer["result"].get("value")

    def complaints(self, known: tuple[str, ...] = ()) -> list[str]:
        """The warnings, errors and uncaught exceptions on the console since the page was opened, but for OWN_WORDS and `known`
        ones, by a part of their text."""
        self.run("0")  # so that events on the way are read
        out = []
        for event in self._events:
            given = event.get("params", {})
            if event.get("method") == "Log.entryAdded" and given["entry"]["level"] in ("warning", "error"):
                out.append(str(given["entry"]["text"]))
            elif event.get("method") == "Runtime.exceptionThrown":
                thrown = given["exceptionDetails"]
                out.append(str(thrown.get("exception", {}).get("description", thrown["text"])))
            elif event.get("method") == "Runtime.consoleAPICalled" and given["type"] in ("warning", "error", "assert"):
                out.append(" ".join(str(argument.get("value", argument.get("description"))) for argument in given["args"]))
        return [text for text in out if not any(own in text for own in (*OWN_WORDS, *known))]

    def screenshot(self, **options: object) -> bytes:
        """The window as PNG; `options` are those of the protocol's Page.captureScreenshot."""
        return base64.b64decode(self.ask("Page.captureScreenshot", {"format": "png", **options})["data"])

    def whole_screenshot(self, width: int, height: int) -> bytes:
        """The page's upper left corner as PNG, as large as asked for, with all its pictures loaded."""
        self.run("Promise.all([...document.images].filter(i => i.checkVisibility()).map(i => "
                 "{ i.loading = 'eager'; return i.decode().catch(() => 0); })).then(() => 0)")
        return self.screenshot(clip={"x": 0, "y": 0, "width": width, "height": height, "scale": 1}, captureBeyondViewport=True)

    def _mouse(self, kind: str, x: float, y: float, **more: object) -> None:
        self.ask("Input.dispatchMouseEvent", {"type": kind, "x": x, "y": y, **more})

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


def _pipe() -> tuple[int, int]:
    """The ends for reading and for writing of a pipe, with numbers that are none of Chromium's."""
    out = []
    for end in os.pipe():
        out.append(fcntl.fcntl(end, fcntl.F_DUPFD_CLOEXEC, 10))
        os.close(end)
    return out[0], out[1]


@contextmanager
def browser() -> Iterator[Browser]:
    """A headless browser.

    Raises:
        InputError: Chromium is not installed, or it does not start.
    """
    program = find_chromium()
    if program is None:
        raise InputError(f"screenshots need Chromium, which is not installed: {HINT}")
    (to_read, to_write), (from_read, from_write) = _pipe(), _pipe()
    options = list(FLAGS)
    if os.getuid() == 0:  # Chromium's sandbox refuses to run as root
        options.append("--no-sandbox")
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        start = [sys.executable, "-S", "-E", "-c", _START, str(to_read), str(from_write)]
        running = subprocess.Popen([*start, program, *options, f"--user-data-dir={folder}", "about:blank"],
                                   pass_fds=(to_read, from_write), stderr=subprocess.DEVNULL, stdout=subprocess.DEVNULL)
        os.close(to_read)
        os.close(from_write)
        try:
            yield Browser(to_write, from_read)
        finally:
            os.close(to_write)
            os.close(from_read)
            running.terminate()
            try:
                running.wait(10)
            except subprocess.TimeoutExpired:
                running.kill()
                running.wait()
