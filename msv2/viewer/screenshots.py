"""Pictures of the viewer itself, taken by a headless Chromium that uses it with the mouse as a user would."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from golden.scenes.request import make_folder
from msv2.viewer.chromium import Browser
from msv2.viewer.server import Viewer
from msv2.viewer.session import Session
from msv2.viewer.state import ANAGLYPH, FLOAT, GOLDEN, ONE, SIDE_BY_SIDE
from msv2.viewer.window import Window
from spec.errors import InputError

SIZE = (1280, 800)
OPEN_S, SETTLE_S, SHOWN_S = 60.0, 120.0, 0.8
"""How long the page may take to open, and a state to be drawn and reckoned; how long a picture takes to appear."""


@contextmanager
def opened(session: Session) -> Iterator[tuple[Browser, Window]]:
    """A browser with the viewer open and its first picture drawn.

    Raises:
        InputError: there is no Chromium, or it does not open the viewer.
    """
    with Browser(SIZE) as browser:
        viewer = Viewer(session, "127.0.0.1", 0)
        try:
            browser.open(viewer.url)
            try:
                window = viewer.window(OPEN_S)
            except TimeoutError as error:
                raise InputError(f"{error}; does the browser have WebGL?") from error
            settled(window)
            browser.evaluate("document.querySelectorAll('.mantine-Notification-closeButton').forEach(each => each.click())")
            yield browser, window
        finally:
            viewer.close()


def settled(window: Window) -> None:
    """Waits until the window's state is drawn, reckoned and visible. Raises TimeoutError."""
    if not window.settle(SETTLE_S):
        raise TimeoutError(f"the state must be drawn within {SETTLE_S:g} s")
    time.sleep(SHOWN_S)


def middle(browser: Browser, element: str) -> tuple[float, float]:
    """The middle of an element of the page, which a JavaScript expression names."""
    box = f"{element}.getBoundingClientRect()"
    return tuple(browser.evaluate(f"{box}.{edge} + {box}.{length} / 2") for edge, length in (("x", "width"), ("y", "height")))


CANVAS = "document.querySelector('canvas')"
"""The picture."""


def show_tab(browser: Browser, name: str) -> None:
    """Opens one of the tabs with controls."""
    browser.click(*middle(browser, f"[...document.querySelectorAll('[role=tab]')].find(tab => tab.innerText == {name!r})"))
    time.sleep(0.3)


def take(session: Session, folder: Path) -> list[Path]:
    """Uses the viewer and takes a picture of every step; returns the files.

    Raises:
        InputError: see `opened`.
    """
    out, files = make_folder(folder), []
    with opened(session) as (browser, window):
        def shot(name: str, tab: str = "Controls", **changes: object) -> None:
            if changes:
                window.change(**changes)
            settled(window)
            show_tab(browser, tab)
            files.append(browser.save_screenshot(out / f"{name}.png"))

        x, y = middle(browser, CANVAS)
        shot("start")
        shot("machine", "Machine")
        browser.drag((x, y), (x + 120, y + 20))
        time.sleep(0.5)
        shot("camera")
        browser.click(x - 60, y)
        time.sleep(0.5)
        shot("gaze")
        shot("levels", overlay="levels")
        shot("error", overlay="error")
        shot("depth", overlay="depth")
        shot("intersections", overlay="intersections")
        shot("float", overlay="none", renderer=FLOAT)
        shot("side_by_side", renderer=GOLDEN, eyes=SIDE_BY_SIDE)
        shot("warp", overlay="warp")
        shot("anaglyph", overlay="none", eyes=ANAGLYPH)
        window.change(eyes=ONE)
        settled(window)
        browser.click(x, y, shift=True)
        time.sleep(0.5)
        shot("splat", "Splat")
        complaints = browser.complaints()
    if complaints:
        print("in the browser's console:", *complaints, sep="\n  ")
    return files
