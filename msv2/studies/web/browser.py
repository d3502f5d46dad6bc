"""Looks at a page in headless Chromium: screenshots at two widths, and what a reader would stumble over.

Chromium is driven through its debugging pipe, so that no package is needed. Its command line alone does not serve, because a
window of it is at least 500 pixels wide.
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
from pathlib import Path
from typing import Any

from golden.scenes.files import atomic_output
from spec.errors import InputError

NAMES = ("chromium", "chromium-browser", "google-chrome")
HINT = "apt-get install chromium"
WIDTHS = (1280, 400)
"""Widths in pixels of the windows in which a page is looked at: that of a small laptop, and that of a telephone."""

HEIGHT = 800
TALLEST = 12000
"""Height in pixels below which a picture of an unfolded page is cut."""

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

    def open(self, page: Path, width: int, height: int = HEIGHT) -> None:
        """Opens a file in a window of this size, and waits until it is loaded."""
        self.ask("Emulation.setDeviceMetricsOverride",
                 {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": False})
        self._events.clear()
        self.ask("Page.navigate", {"url": page.resolve().as_uri()})
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

    def complaints(self) -> list[str]:
        """The warnings and errors that the page has printed on the console since it was opened."""
        self.run("0")  # so that events on the way are read
        out = []
        for event in self._events:
            given = event.get("params", {})
            if event.get("method") == "Log.entryAdded" and given["entry"]["level"] in ("warning", "error"):
                out.append(str(given["entry"]["text"]))
            elif event.get("method") == "Runtime.exceptionThrown":
                out.append(str(given["exceptionDetails"]["text"]))
            elif event.get("method") == "Runtime.consoleAPICalled" and given["type"] in ("warning", "error"):
                out.append(" ".join(str(argument.get("value")) for argument in given["args"]))
        return out

    def shot(self, path: Path, width: int, height: int) -> None:
        """Writes a PNG of the page's upper left corner, as large as asked for."""
        self.run("Promise.all([...document.images].filter(i => i.checkVisibility()).map(i => "
                 "{ i.loading = 'eager'; return i.decode().catch(() => 0); })).then(() => 0)")
        clip = {"x": 0, "y": 0, "width": width, "height": height, "scale": 1}
        made = self.ask("Page.captureScreenshot", {"format": "png", "clip": clip, "captureBeyondViewport": True})
        with atomic_output(path) as file:
            file.write(base64.b64decode(made["data"]))


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
    options = ["--headless", "--remote-debugging-pipe", "--disable-gpu", "--hide-scrollbars", "--no-first-run"]
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


_MEASURE = """(() => {
  const root = document.documentElement, summary = document.getElementById('summary');
  const wide = [...document.querySelectorAll('body *')].filter(e => !e.closest('.table, .plot, pre') && e.checkVisibility()
    && e.getBoundingClientRect().right > innerWidth + 1).map(e => e.tagName + ': ' + e.textContent.slice(0, 40));
  const broken = [...document.images].filter(i => i.checkVisibility() && i.complete && !i.naturalWidth).map(i => i.alt);
  return {width: root.scrollWidth, height: root.scrollHeight, wide, broken,
          summary: summary ? Math.ceil(summary.getBoundingClientRect().bottom) : 0};
})()"""


def look(page: Path, folder: Path) -> tuple[list[Path], list[str]]:
    """Writes screenshots NAME_WIDTH.png of a page as it opens, and NAME_WIDTH_unfolded.png with all sections unfolded.

    Args:
        page: the HTML file.
        folder: an existing folder.

    Returns:
        The screenshots, and what a reader would stumble over, in words: a page that is wider than its window, a summary that is
        longer than one screen at the larger width, pictures that do not load, and messages on the console.

    Raises:
        InputError: Chromium is not installed, or it fails.
    """
    made, found = [], []
    with browser() as window:
        for width in WIDTHS:
            window.open(page, width)
            for state in ("", "_unfolded"):
                if state:
                    window.run("document.querySelectorAll('details').forEach(e => { e.open = true; })")
                path = folder / f"{page.stem}_{width}{state}.png"
                size = window.run(_MEASURE)
                window.shot(path, width, min(size["height"], TALLEST))
                size = window.run(_MEASURE)
                made.append(path)
                where = f"{page.name} at {width} pixels{' unfolded' if state else ''}: "
                if size["width"] > width:
                    found.append(f"{where}{size['width']} pixels wide: {'; '.join(size['wide'][:3])}")
                found += [f"{where}the picture {alt!r} does not load" for alt in size["broken"]]
                if not state and width == max(WIDTHS) and size["summary"] > HEIGHT:
                    found.append(f"{where}the summary is {size['summary']} pixels high, more than {HEIGHT}")
            found += [f"{page.name} at {width} pixels: console: {text}" for text in window.complaints()]
    return made, found


def take_screenshots(page: Path, folder: Path) -> bool:
    """Looks at a page for a command line: prints the screenshots and the findings, or how to install Chromium where it is
    absent. Returns whether nothing was found."""
    if find_chromium() is None:
        print(f"no screenshots: Chromium is not installed ({HINT})")
        return True
    made, found = look(page, folder)
    print("\n".join([*(f"screenshot: {path}" for path in made), *(f"LOOK: {line}" for line in found)]))
    return not found
